"""Write the manual's pages that come from the code: `python tools/write_reference.py [--check]`.

`docs/relations.md` comes from the registry of relations and functions, `docs/tables.md` from the
tables' columns. With `--check` nothing is written, and the exit status is 1 if a page differs.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from ssduck.adapters import ADAPTERS
from ssduck.functions import BUILTINS
from ssduck.tables import TABLES, Column
from ssduck.udfs import RELATIONS, Relation

DOCS = Path(__file__).resolve().parent.parent / "docs"

RELATIONS_HEAD = """# Relations and functions

Metres, radians, kilograms; world frame; quaternions w, x, y, z. A relation of an entity with
itself is False, a distance 0. An unknown value is NULL (None in Python), never NaN.

A relation is a function of entities in SelectScript (`above(table, this)`) and a function of rows
of `entities` in raw SQL (`FROM entities a, entities b WHERE above(a, b)`). In raw SQL `position`
is written `"position"(a)`, for it is a word of SQL's; an alias must not be the name of a column
(`FROM entities x` hides the row `x` behind the column `x`). Relations of sensors look things up in
the table `sensings`; in raw SQL they are for one world, for a row does not tell which one it is of.

## Relations
"""

TABLES_HEAD = """# Tables

Each world is a schema of its name (`kitchen.entities`); the tables of the first world go without
it (`entities`). All rows are of the world's last tick. `links`, `joints`, `shapes`, `contacts` and
`sensings` are read from the simulator from when they are first asked for.

Metres, seconds, kilograms, newtons, radians; world frame; quaternions w, x, y, z; positions are
those of link frames, not of centres of mass.
"""


def relation_lines(relation: Relation) -> Iterator[str]:
    """The entry of a relation."""
    yield f"\n### `{relation.usage}`\n"
    unit = f" Unit: {relation.unit}." if relation.unit else ""
    symmetric = " The order of the two does not matter." if relation.symmetric else ""
    yield f"{relation.about}{unit}{symmetric}\n"
    for parameter in relation.parameters:
        yield f"- `{parameter.name}`: {parameter.meaning}"


def relations_page() -> str:
    """The page of the relations, the plain functions and the result forms."""
    lines = [RELATIONS_HEAD.rstrip()]
    for relation in RELATIONS.values():
        lines += relation_lines(relation)
    lines += ["\n## Functions of plain values\n", "| function | what it does |", "|---|---|"]
    for function in BUILTINS.values():
        about, usage = function.help.split("\nUsage: ")
        lines.append(f"| `{usage}` | {about} |")
    lines += ["\n## Result forms\n", "| AS | what it gives |", "|---|---|"]
    for adapter in dict.fromkeys(ADAPTERS.values()):
        names = ", ".join(f"`{name}`" for name in adapter.names)
        lines.append(f"| {names} | {adapter.help} |")
    return "\n".join(lines) + "\n"


def merged(columns: tuple[Column, ...]) -> Iterator[tuple[str, str, str]]:
    """Neighbouring columns of one meaning as one row."""
    names: list[str] = []
    for index, column in enumerate(columns):
        names.append(column.name)
        following = columns[index + 1] if index + 1 < len(columns) else None
        if following is None or following[1:] != column[1:]:
            yield " ".join(names), column.type, column.comment
            names = []


def tables_page() -> str:
    """The page of the tables."""
    lines = [TABLES_HEAD.rstrip()]
    for name, columns in TABLES.items():
        lines += [f"\n## `{name}`\n", "| columns | type | meaning |", "|---|---|---|"]
        lines += [f"| {names} | {kind} | {comment} |" for names, kind, comment in merged(columns)]
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description="Write the manual's generated pages.")
    parser.add_argument("--check", action="store_true", help="only report pages that differ")
    check = parser.parse_args().check
    stale = []
    for name, text in (("relations.md", relations_page()), ("tables.md", tables_page())):
        path = DOCS / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            stale.append(name)
            if not check:
                path.write_text(text, encoding="utf-8")
    for name in stale:
        print(f"{name} {'differs' if check else 'written'}")
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
