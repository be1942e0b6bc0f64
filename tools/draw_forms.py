"""Draws the pictures of docs/reference/result-forms.md.

`python tools/draw_forms.py [FOLDER]` writes them to docs/images or to another folder, in less than
a minute. All show the shipped kitchen. Pictures of grids are enlarged ones of `grid.image()`.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

import ssduck
from ssduck.simulators.scenes import Camera

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
BOUNDS = "bounds=[[-1.75, -2.5], [2.45, 2.7]]"


@dataclass(frozen=True)
class Picture:
    """Programs whose grids are drawn side by side.

    Attributes:
        programs: the programs.
        scale: the width of a cell, pixels.
        over: a program whose occupied cells are drawn over each grid.
    """

    programs: tuple[str, ...]
    scale: int
    over: str | None = None


ALL = "SELECT obj FROM kitchen AS"
ROOMBA = "roomba = SELECT obj FROM kitchen WHERE id(this) == 'roomba_625x' AS value;"
NEAR = "SELECT obj FROM kitchen WHERE distance(roomba, this) <= 1.5 AS roombaGrid;"
PICTURES = {
    "occupancygrid": Picture(
        (
            f"{ALL} occupancygrid(0.22, 0.02, {BOUNDS});",
            f"{ALL} occupancygrid([0.2, 1.0], 0.02, {BOUNDS});",
        ),
        2,
    ),
    "roombagrid": Picture((f"{ALL} roombaGrid;", f"{ROOMBA} {NEAR}"), 2),
    "voxelgrid": Picture((f"{ALL} voxelgrid(0.05);",), 5),
    "sensorgrid": Picture(
        (f"SELECT obj FROM kitchen WHERE isSensor(this) AS sensorgrid(0.24, 0.04, {BOUNDS});",),
        4,
        over=f"{ALL} occupancygrid(0.24, 0.04, {BOUNDS});",
    ),
    "plane": Picture(
        (
            "SELECT mass FROM kitchen AS plane('XY', [-2, -3], [50, 60, 0.1]);",
            "SELECT mass FROM kitchen AS plane('XY', [-2, -3], [50, 60, 0.1], 6);",
        ),
        6,
    ),
}
GAP = 12
NEAREST = Image.Resampling.NEAREST


def draw_grids(ss: ssduck.Interpreter, picture: Picture) -> Image.Image:
    grids = [ss.eval(program).image() for program in picture.programs]
    if picture.over is not None:
        shapes = ss.eval(picture.over).image()
        for grid in grids:
            grid.paste(shapes, mask=shapes.point(lambda shade: 255 * (shade < 128)))
    grids = [
        grid.resize((grid.width * picture.scale, grid.height * picture.scale), NEAREST)
        for grid in grids
    ]
    width = sum(grid.width for grid in grids) + GAP * (len(grids) + 1)
    whole = Image.new("RGB", (width, max(grid.height for grid in grids) + 2 * GAP), (200, 210, 220))
    left = GAP
    for grid in grids:
        whole.paste(grid.convert("RGB"), (left, GAP))
        left += grid.width + GAP
    return whole


# -- other pictures -------------------------------------------------------------------------------

SIZE = (640, 420)
COLOURS = [(31, 119, 180), (214, 39, 40), (44, 160, 44), (255, 127, 14), (148, 103, 189)]


def view(ss: ssduck.Interpreter) -> Image.Image:
    robots: Image.Image = ss.eval(f"SELECT obj FROM kitchen WHERE isRobot(this) AS image{SIZE};")
    return robots.quantize(64)


def sub_scene(ss: ssduck.Interpreter) -> Image.Image:
    world = ss.eval(f"{ROOMBA} {NEAR.replace('roombaGrid', 'environment')}")
    camera = Camera(eye=(2.9, -1.9, 1.9), target=(1.0, 0.0, 0.3), fov=45)
    picture = Image.fromarray(world.render(*SIZE, camera))
    world.close()
    return picture.quantize(64)


def cloud(ss: ssduck.Interpreter) -> Image.Image:
    """Draws points, with a colour for each entity, from the side and slightly from above."""
    table = "table = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;"
    near = "SELECT obj FROM kitchen WHERE distance(table, this) < 1.3 AND volume(this) < 1"
    cloud_points = ss.eval(f"{table} {near} AND NOT isSensor(this) AS points(0.02);")
    x, y, z = cloud_points.points.T
    across, up = x * 0.9 - y * 0.35, z * 0.9 + (x * 0.35 + y * 0.9) * 0.4
    pixels = np.full((SIZE[1], SIZE[0], 3), 255, dtype=np.uint8)
    scale = min((SIZE[0] - 20) / np.ptp(across), (SIZE[1] - 20) / np.ptp(up))
    columns = (10 + (across - across.min()) * scale).astype(int)
    rows = (SIZE[1] - 10 - (up - up.min()) * scale).astype(int)
    pixels[rows, columns] = np.array(COLOURS)[cloud_points.owners % len(COLOURS)]
    return Image.fromarray(pixels).quantize(16)


def network(ss: ssduck.Interpreter) -> Image.Image:
    """Returns the graph of `above`, drawn by networkx and matplotlib."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    import networkx as nx

    above = "above(a.this, b.this) AND NOT (isSensor(a.this) OR isSensor(b.this))"
    graph = ss.eval(f"SELECT a.this, b.this FROM a=kitchen, b=kitchen WHERE {above} AS graph;")
    figure, axes = plt.subplots(figsize=(6.4, 4.2), dpi=100)
    nx.draw_networkx(graph, nx.shell_layout(graph), ax=axes, node_color="#ffd27f", font_size=8)
    axes.axis("off")
    axes.margins(0.15)
    figure.tight_layout()
    png = io.BytesIO()
    figure.savefig(png, format="png")
    plt.close(figure)
    return Image.open(png).convert("RGB").quantize(32)


VIEWS: dict[str, Callable[[ssduck.Interpreter], Image.Image]] = {
    "image": view,
    "environment": sub_scene,
    "points": cloud,
    "graph": network,
}


def main() -> None:
    folder = Path(sys.argv[1]) if sys.argv[1:] else IMAGES
    with ssduck.load("kitchen") as ss:
        for name, picture in PICTURES.items():
            draw_grids(ss, picture).save(folder / f"{name}.png", optimize=True)
        for name, draw in VIEWS.items():
            draw(ss).save(folder / f"forms-{name}.png", optimize=True)


if __name__ == "__main__":
    main()
