"""Draws the picture of the page of `ssduck view` in the README and the manual.

`python -m tools.draw_page [FOLDER]` writes it to docs/images or to another folder. It needs
Chromium, and shows the shipped kitchen with the answer of a query.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from PIL import Image

import ssduck
from tools.browser import Browser

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
QUERY = "SELECT id, z FROM kitchen WHERE above(kitchen.table, this);"


def draw(folder: Path) -> Path:
    """Writes the picture into a folder; returns its path."""
    path = folder / "view.png"
    with ssduck.load("kitchen") as ss, tempfile.TemporaryDirectory() as profile:
        served = ss.view()
        browser = Browser(Path(profile))
        try:
            page = browser.open(served.url)
            page.wait("window.__ss && __ss.ready")
            page.ask(QUERY)
            picture = Image.fromarray(page.picture())
        finally:
            browser.close()
            served.close()
    picture.quantize(192).save(path, optimize=True)
    return path


if __name__ == "__main__":
    print(draw(Path(sys.argv[1]) if sys.argv[1:] else IMAGES))
