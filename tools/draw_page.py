"""Draws the pictures of the page of `ssduck view` in the README and the manual.

`python -m tools.draw_page [FOLDER]` writes them to docs/images or to another folder. It needs
Chromium, and shows the shipped kitchen with the answer of a query, a record with its time line, and
why a condition did not hold.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image

import ssduck
from ssduck.view.view import view_record
from tools.browser import Browser, Page

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
CUP = "cup_905a"
LASTING = f"holds(on(kitchen.table, kitchen.{CUP}));"
WHY = f"WHY always(z(kitchen.{CUP}) < 1.2 AND near(kitchen.table, kitchen.{CUP}, 0.3));"
QUERY = "SELECT id, z FROM kitchen WHERE above(kitchen.table, this);"


def draw(folder: Path) -> Path:
    """Writes the picture of a live world into a folder; returns its path."""
    with ssduck.load("kitchen") as ss, ss.view() as served, _page(served.url) as page:
        page.ask(QUERY)
        return _save(page, folder / "view.png")


def draw_time(folder: Path) -> Path:
    """Writes the picture of a record into a folder; returns its path."""
    with tempfile.TemporaryDirectory() as place:
        _record(Path(place) / "run")
        with view_record(Path(place) / "run") as served, _page(served.url) as page:
            page.wait("__ss.ticks > 0")
            page.ask(LASTING)
            page.click(*page.value(f"__ss.placeOf('{CUP}')"))
            page.wait(f"__ss.picked === '{CUP}'")
            page.value("document.getElementById('next').click(); 0")
            page.value("__ss.seek(__ss.index + 60); 0")
            page.wait("__ss.local > 0 && !!document.querySelector('.plot .curve')")
            page.value("document.getElementById('entity').scrollTop = 1e5; 0")
            page.wait("Number(document.querySelector('.cursor').getAttribute('x1')) > 100")
            # The query is asked again at the time that is shown.
            page.wait("document.getElementById('count').textContent.includes(__ss.time.toFixed(3))")
            return _save(page, folder / "view-time.png")


def draw_why(folder: Path) -> Path:
    """Writes the picture of why a condition did not hold into a folder; returns its path."""
    with tempfile.TemporaryDirectory() as place:
        _record(Path(place) / "run")
        with view_record(Path(place) / "run") as served, _page(served.url) as page:
            page.wait("__ss.ticks > 0")
            page.ask(WHY)
            page.wait("__ss.time > 1 && __ss.drawings > 0 && __ss.scans > 0")
            return _save(page, folder / "view-why.png")


def _record(path: Path) -> None:
    """Records a cup that is lifted from the table, and falls."""
    with ssduck.load("kitchen") as ss:
        kitchen = ss["kitchen"]
        with ss.record_to(path):
            for step in range(100):
                if 30 < step < 65:
                    x, y, z = kitchen[CUP].position
                    kitchen[CUP].move([x - 0.005, y - 0.005, z + 0.012])
                ss.run(1 / 60)


@contextmanager
def _page(url: str) -> Iterator[Page]:
    with tempfile.TemporaryDirectory() as profile:
        browser = Browser(Path(profile))
        try:
            page = browser.open(url)
            page.wait("window.__ss && __ss.ready")
            yield page
        finally:
            browser.close()


def _save(page: Page, path: Path) -> Path:
    Image.fromarray(page.picture()).quantize(192, kmeans=2).save(path, optimize=True)
    return path


if __name__ == "__main__":
    place = Path(sys.argv[1]) if sys.argv[1:] else IMAGES
    print(draw(place), draw_time(place), draw_why(place))
