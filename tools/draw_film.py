"""Draws the picture and the film of the kitchen in the README.

`python -m tools.draw_film [FOLDER]` writes kitchen.png and cleanup.gif to docs/images or to another
folder, in some two minutes. It needs the extra `render`.
"""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

import ssduck
from examples.cleanup.program import clean
from ssduck.render import Film, filmed, render
from ssduck.simulators.scenes import Camera

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
CAMERA = Camera(eye=(2.9, -0.6, 2.1), target=(0.9, 0.75, 0.75), fov=42.0)
CLEANUP = Film(speed=12, fps=8, size=(480, 300), camera=CAMERA)


def draw(folder: Path) -> tuple[Path, Path]:
    """Writes the picture and the film into a folder; returns their paths."""
    picture = render("kitchen", folder / "kitchen.png", Film(size=(960, 600)))
    with Image.open(picture) as image:
        image.quantize(192).save(picture, optimize=True)
    film = folder / "cleanup.gif"
    with ssduck.load("kitchen") as ss, filmed(ss.worlds[0], film, CLEANUP):
        clean(ss, None, lambda *_: None, seed=0)
    return picture, film


if __name__ == "__main__":
    print(*draw(Path(sys.argv[1]) if sys.argv[1:] else IMAGES), sep="\n")
