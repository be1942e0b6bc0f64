"""Draws docs/images/shell.svg: a session of the shell, with what it really answers.

`python -m tools.draw_shell [FOLDER]` writes it there or to another folder, in some seconds.
"""

from __future__ import annotations

import contextlib
import io
import sys
from pathlib import Path

from rich.console import Console
from rich.text import Text

import ssduck
from ssduck.shell.session import Session, greet, run

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
TYPED = (
    "SELECT id, z, mass FROM kitchen WHERE isRobot(this);",
    "SELECT id FROM kitchen WHERE on(kitchen.table, this);",
    ".mode sql",
    "SELECT name, z FROM entities WHERE name LIKE 'cup%' ORDER BY name LIMIT 3;",
)
# A terminal without a frame, in the font of who looks at it.
FORMAT = """\
<svg viewBox="0 0 {width} {height}" xmlns="http://www.w3.org/2000/svg">
<style>.{unique_id}-matrix {{ font-family: monospace; font-size: {char_height}px; }}
{styles}</style>
<defs><clipPath id="{unique_id}-clip-terminal">
<rect width="{terminal_width}" height="{terminal_height}"/></clipPath>{lines}</defs>
{chrome}
<g transform="translate({terminal_x}, {terminal_y})" clip-path="url(#{unique_id}-clip-terminal)">
{backgrounds}<g class="{unique_id}-matrix">{matrix}</g></g>
</svg>
"""


def session_text() -> Text:
    """Returns a session: what is typed after a prompt in bold, and what the shell prints."""
    text = Text()
    with ssduck.load("kitchen") as ss:
        session = Session(ss)
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            greet(session)
        text.append(printed.getvalue() + "\n")
        for typed in TYPED:
            text.append(session.prompt, "bold green").append(f"{typed}\n", "bold")
            with contextlib.redirect_stdout(io.StringIO()) as printed:
                if not run(session, typed):
                    raise RuntimeError(f"{typed} fails")
            text.append(printed.getvalue() + "\n")
    return text


def draw(folder: Path) -> Path:
    """Draws the session; returns the path of the picture."""
    console = Console(record=True, width=100, file=io.StringIO())
    console.print(session_text())
    path = folder / "shell.svg"
    svg = console.export_svg(title="ssduck shell kitchen", unique_id="shell", code_format=FORMAT)
    path.write_text(svg, encoding="utf-8")
    return path


if __name__ == "__main__":
    print(draw(Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES))
