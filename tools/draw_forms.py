"""Draws the pictures of docs/reference/result-forms.md.

`python tools/draw_forms.py [FOLDER]` writes them to docs/images or to another folder, in less than
a minute. All show the shipped kitchen, most of them as notebooks do, with axes and a legend.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from PIL import Image

import ssduck
from ssduck.simulators.scenes import Camera

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
BOUNDS = "bounds=[[-1.75, -2.5], [2.45, 2.7]]"


ALL = "SELECT obj FROM kitchen AS"
ROOMBA = "roomba = SELECT obj FROM kitchen WHERE id(this) == 'roomba_625x' AS value;"
NEAR = "SELECT obj FROM kitchen WHERE distance(roomba, this) <= 1.5 AS roombaGrid;"
SENSORS = "SELECT obj FROM kitchen WHERE isSensor(this) AS"
MASSES = "SELECT mass FROM kitchen AS plane('XY', [-2, -3], [50, 60, 0.1]"
# The programs whose grids are drawn side by side.
PICTURES = {
    "occupancygrid": (
        f"{ALL} occupancygrid(0.22, 0.02, {BOUNDS});",
        f"{ALL} occupancygrid([0.2, 1.0], 0.02, {BOUNDS});",
    ),
    "roombagrid": (f"{ALL} roombaGrid;", f"{ROOMBA} {NEAR}"),
    "voxelgrid": (f"{ALL} voxelgrid(0.05);",),
    "sensorgrid": (
        f"{SENSORS} sensorgrid(0.24, 0.04, {BOUNDS});",
        f"{ALL} occupancygrid(0.24, 0.04, {BOUNDS});",
    ),
    "plane": (f"{MASSES});", f"{MASSES}, 6);"),
}
GAP = 12


def draw_grids(ss: ssduck.Interpreter, programs: tuple[str, ...]) -> Image.Image:
    charts = [ss.eval(program).chart() for program in programs]
    width = sum(chart.width for chart in charts) + GAP * (len(charts) - 1)
    whole = Image.new("RGB", (width, max(chart.height for chart in charts)), (255, 255, 255))
    left = 0
    for chart in charts:
        whole.paste(chart, (left, 0))
        left += chart.width + GAP
    return whole.quantize(128)


# -- other pictures -------------------------------------------------------------------------------

SIZE = (640, 420)


def view(ss: ssduck.Interpreter) -> Image.Image:
    robots: Image.Image = ss.eval(f"SELECT obj FROM kitchen WHERE isRobot(this) AS image{SIZE};")
    return robots.quantize(64)


def sub_scene(ss: ssduck.Interpreter) -> Image.Image:
    world = ss.eval(f"{ROOMBA} {NEAR.replace('roombaGrid', 'environment')}")
    camera = Camera(eye=(2.9, -1.9, 1.9), target=(1.0, 0.0, 0.3), fov=45)
    picture = Image.fromarray(world.render(*SIZE, camera))
    world.close()
    return picture.quantize(64)


TABLE = "table = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;"
AROUND = "SELECT obj FROM kitchen WHERE distance(table, this) < 1.3 AND volume(this) < 1"


def cloud(ss: ssduck.Interpreter) -> Image.Image:
    points = ss.eval(f"{TABLE} {AROUND} AND NOT isSensor(this) AS points(0.02);")
    picture: Image.Image = points.image()
    return picture.quantize(64)


def mesh(ss: ssduck.Interpreter) -> Image.Image:
    scene = ss.eval(f"{TABLE} {AROUND} AND NOT isSensor(this) AS mesh;")
    picture: Image.Image = scene.image()
    return picture.quantize(128)


def network(ss: ssduck.Interpreter) -> Image.Image:
    above = "above(a.this, b.this) AND NOT (isSensor(a.this) OR isSensor(b.this))"
    graph = ss.eval(f"SELECT a.this, b.this FROM a=kitchen, b=kitchen WHERE {above} AS graph;")
    picture: Image.Image = graph.image()
    return picture.quantize(64)


VIEWS: dict[str, Callable[[ssduck.Interpreter], Image.Image]] = {
    "image": view,
    "environment": sub_scene,
    "points": cloud,
    "mesh": mesh,
    "graph": network,
}


def main() -> None:
    folder = Path(sys.argv[1]) if sys.argv[1:] else IMAGES
    with ssduck.load("kitchen") as ss:
        for name, programs in PICTURES.items():
            draw_grids(ss, programs).save(folder / f"{name}.png", optimize=True)
        for name, draw in VIEWS.items():
            draw(ss).save(folder / f"forms-{name}.png", optimize=True)


if __name__ == "__main__":
    main()
