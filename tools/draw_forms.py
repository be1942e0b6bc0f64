"""Draw the pictures of docs/adapters.md: `python tools/draw_forms.py [FOLDER]`, docs by default.

Each picture is a form's own, `grid.image()`, of the shipped kitchen, its pixels enlarged.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

import ssduck

DOCS = Path(__file__).resolve().parent.parent / "docs"
BOUNDS = "bounds=[[-1.75, -2.5], [2.45, 2.7]]"


@dataclass(frozen=True)
class Picture:
    """Programs whose grids are drawn side by side.

    Attributes:
        programs: the programs.
        times: how many pixels a cell is wide.
        over: a program whose occupied cells are drawn over each of them.
    """

    programs: tuple[str, ...]
    times: int
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


def drawn(ss: ssduck.Interpreter, picture: Picture) -> Image.Image:
    times = picture.times
    grids = [ss.eval(program).image() for program in picture.programs]
    if picture.over is not None:
        shapes = ss.eval(picture.over).image()
        for grid in grids:
            grid.paste(shapes, mask=shapes.point(lambda shade: 255 * (shade < 128)))
    grids = [grid.resize((grid.width * times, grid.height * times), NEAREST) for grid in grids]
    width = sum(grid.width for grid in grids) + GAP * (len(grids) + 1)
    whole = Image.new("RGB", (width, max(grid.height for grid in grids) + 2 * GAP), (200, 210, 220))
    left = GAP
    for grid in grids:
        whole.paste(grid.convert("RGB"), (left, GAP))
        left += grid.width + GAP
    return whole


def main() -> None:
    folder = Path(sys.argv[1]) if sys.argv[1:] else DOCS
    with ssduck.load("kitchen") as ss:
        for name, picture in PICTURES.items():
            drawn(ss, picture).save(folder / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
