"""Draws docs/images/notebook.png: a notebook with the magics of ssduck, and what it really shows.

`python -m tools.draw_notebook [FOLDER]` writes it there or to another folder. A kernel of its own
runs the cells; Chromium shows the page that nbconvert makes of them.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from PIL import Image

from tools.browser import Browser

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
CELLS = (
    '%load_ext ssduck\nimport ssduck\nss = ssduck.load("kitchen")',
    "%%selectscript\nSELECT id, z, mass FROM kitchen WHERE isRobot(this);",
    "rows = %sql SELECT name, z FROM entities WHERE name LIKE 'cup%' ORDER BY name LIMIT 2\nrows",
    """%%selectscript
SELECT this FROM kitchen WHERE on(kitchen.table, this) OR id(this) == 'table'
AS points(0.03);""",
)
# Of the picture, pixels.
SIZE = (760, 1140)


def notebook() -> dict[str, Any]:
    """Returns the notebook, which no kernel has run yet."""
    cells: list[dict[str, Any]] = [
        {
            "cell_type": "code",
            "execution_count": None,
            "id": f"cell-{number}",
            "metadata": {},
            "outputs": [],
            "source": source,
        }
        for number, source in enumerate(CELLS)
    ]
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return {
        "cells": cells,
        "metadata": {"kernelspec": kernel},
        "nbformat": 4,
        "nbformat_minor": 5,
    }


def executed(folder: Path) -> Path:
    """Runs the cells in a kernel; returns the path of the notebook with their outputs."""
    path = folder / "typed.ipynb"
    path.write_text(json.dumps(notebook()), encoding="utf-8")
    _convert(path, "notebook", "--execute", "--output", "run.ipynb")
    return folder / "run.ipynb"


def draw(folder: Path) -> Path:
    """Writes the picture into a folder; returns its path."""
    with tempfile.TemporaryDirectory() as place:
        run = executed(Path(place))
        _convert(run, "html", "--output", "run.html")
        return _save(run.with_suffix(".html"), folder / "notebook.png")


def _convert(path: Path, format: str, *options: str) -> None:
    """Runs nbconvert beside a notebook; neither it nor the kernel reads or writes settings."""
    own = {f"JUPYTER_{name}_DIR": str(path.parent) for name in ("CONFIG", "DATA", "RUNTIME")}
    own |= {"IPYTHONDIR": str(path.parent), "JUPYTER_PLATFORM_DIRS": "1"}
    command = [sys.executable, "-m", "nbconvert", "--to", format, *options, str(path)]
    done = subprocess.run(  # noqa: S603  # its own notebook
        command, env=os.environ | own, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(done.stderr)


def _save(shown: Path, path: Path) -> Path:
    """Writes a picture of a whole page of HTML."""
    with tempfile.TemporaryDirectory() as profile:
        browser = Browser(Path(profile))
        try:
            page = browser.open(shown.as_uri())
            page.resize(*SIZE)
            page.wait(
                "document.readyState === 'complete' && document.querySelector('img')?.complete"
            )
            page.value("document.documentElement.style.overflow = 'hidden'; 0")
            image = Image.fromarray(page.screenshot())
        finally:
            browser.close()
    image.quantize(192).save(path, optimize=True)
    return path


if __name__ == "__main__":
    print(draw(Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES))
