"""Writes the generated pages of the manual.

`python tools/write_reference.py` takes some seconds: it writes `docs/reference/relations.md` from
the registry of relations and functions, `docs/reference/tables.md` from the declarations of
tables, `docs/reference/sql-queries.md` from the tests' `sql_queries.toml` and `room.toml`, and the
marked sections of `docs/reference/command-line.md` from the command `ssduck`.
`--check` only compares them, with exit status 1 if a page differs.
"""

from __future__ import annotations

import argparse
import re
import sys
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from itertools import groupby, islice
from pathlib import Path

import typer
from typer.core import TyperArgument, TyperCommand, TyperOption

from ssduck.adapters.registry import all_adapters
from ssduck.cli.app import app
from ssduck.language.builtins import BUILTINS
from ssduck.schema import TABLES, Column
from ssduck.sql.relations.contacts import CONTACT_RELATIONS, SENSOR_RELATIONS
from ssduck.sql.relations.entities import ENTITY_RELATIONS, REGION_RELATIONS
from ssduck.sql.relations.motion import JOINT_RELATIONS, MOTION_RELATIONS
from ssduck.sql.relations.ode import ODE_RELATIONS
from ssduck.sql.relations.relation import Relation
from ssduck.sql.relations.shapes import SHAPE_RELATIONS

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs" / "reference"
TEST_DATA = ROOT / "tests" / "data"
FAMILIES = {
    "Names, poses and boxes": ENTITY_RELATIONS,
    "Shapes": SHAPE_RELATIONS,
    "Contacts": CONTACT_RELATIONS,
    "Sides and regions": REGION_RELATIONS,
    "Joints": JOINT_RELATIONS,
    "Motion": MOTION_RELATIONS,
    "Names of the ODE dialect": ODE_RELATIONS,
    "Sensors": SENSOR_RELATIONS,
}
# What the help says of an operator as a function.
OPERATOR = re.compile(r"Returns (a \S+ b|-a)\.")
# What the help says of a relation that is another one by another name.
SAME = re.compile(r"the same as `?(\w+)(?:\(|`)")
# So many queries of a group are on the page; the tests have more.
SHOWN_QUERIES = 7

SQL_QUERIES_HEAD = """# Queries of SQL

SelectScript understands most of what users of SQL write, and an error names the right spelling
where it does not. [The language](language.md#spellings-of-sql) gives the rules. Below are queries
as one writes them in SQL, as in `ss.eval("SELECT id, z FROM room")`, each with its value in Python.
For SQL itself, on [tables](tables.md), there is `ss.sql`.

The world `room` has a robot and five kinbodies, three of which move:
"""

RELATIONS_HEAD = """# Relations and functions

Metres, newtons, radians, kilograms; world frame; quaternions w, x, y, z. A relation of an entity
with itself is False, a distance is 0. An unknown value, such as that of a body whose pose is not
a number, is NULL (None in Python), never NaN. In SQL, neither a condition on it nor its negation
holds. Python treats None as false and cannot compare it.

## Boxes and shapes

`above`, `below`, `within`, `overlaps`, `volume` and `aabbVolume` use positions and boxes. They are
formulas over columns, and fast. Relations that say `Calls the narrow phase` use the shapes
themselves: the boxes of two balls side by side may overlap while the balls are apart. `clearance`
compares every pair of which a row needs it; if a bound is enough, `near(a, b, d)` is cheaper.

Of two sources that are the same world, or its links, `collides`, `near`, `touching`, `on`,
`supports`, `contains` and `enclosed` in `WHERE` find all pairs of the tick at once: milliseconds
for a thousand bodies. So do `restsOn` of entities, and raw SQL where `a` and `b` are whole rows of
the current tick (`FROM entities a, entities b`, or a subquery with `SELECT *`). Raw SQL also has
tables of pairs:

```python
import ssduck

ss = ssduck.load("kitchen")
ss.sql("SELECT a, b FROM colliding_pairs()")  # ids of entities
ss.sql("SELECT a, b FROM kitchen.pairs_within(0.02) WHERE a < b")  # of clearances, in metres
ss.sql("SELECT a, b FROM colliding_pairs(0.001)")  # deeper than a millimetre in each other
ss.sql("SELECT a, b FROM link_pairs_within(0.02)")  # ids of links; also colliding_link_pairs()
```

An entity consists of the shapes of all its links: a relation of two entities holds for their
closest shapes. A plane is a solid half-space, so everything below the ground collides with it. A
closed mesh is solid, an open one is a surface. To PyBullet a concave mesh
(`GEOM_FORCE_CONCAVE_TRIMESH`, `concave="yes"`) is a surface even if it is closed: a ball in such a
room has clearance 0 from it, and a warning names the mesh. An entity without shapes, such as a
sensor, touches nothing and is infinitely far from everything. Disabled and invisible entities have
their shapes as before.

Links, and rows of `links`, are compared like entities, with either: a link consists of its own
shapes. It has the relations to its entity that an entity has to itself. Whether a link carries
something together with others (`supports`, `restsOn`, `nextTo`) is asked as if it were a body of
its own. In raw SQL, `id` of a row of `links` is its `name`; the column `full_name` has both names.

```python
import ssduck

ss = ssduck.load("kitchen")
kitchen = ss.call_variable("kitchen").step(480)  # two seconds, until all is at rest
ss.eval("SELECT id FROM kitchen WHERE on(kitchen.table, this) AS list;")  # cups, plates, no chair
ss.eval("SELECT id FROM kitchen WHERE contains(this, kitchen.table) AS list;")  # ['kitchen']
print(ss.statistics()["kitchen"])  # how many pairs that took, and how many calls
```

## Rest and intrusion

In simulators, things at rest do not touch exactly. PyBullet presses boxes, balls, cylinders and
capsules into what they rest on by 0.01 to 0.02 mm, and keeps hulls and concave meshes away from it
by a margin of 1 mm each, which the column `margin` of `shapes` has. Which relation to use:

| question | relation |
|---|---|
| does b rest on a? | `on(a, b)`, which includes margins |
| do they touch? | `touching(a, b)`, which includes margins |
| are they pressed together? | `inContact(a, b)`: the solver found a force |
| does the simulator list a contact? | `hasContact(a, b)`: even if they are moving apart |
| how near are the surfaces? | `clearance(a, b)`, `near(a, b, d)`: the shapes alone |
| is one in the other? | `collides(a, b, 1e-3)`: deeper than 1 mm, not only at rest |

`clearance`, `penetration`, `contactForce` and `nearestPoints` of (a, b) and of (b, a) are the same
to the last bit, live, at past ticks and in records.

## On, in and beside

These relations use shapes and poses alone: they are the same live, at a past tick, in a record
and in a what-if world.

- `on(a, b)`: b stands on a by itself, because its centre is over a. `supports(a, b)`: a carries
  b, alone or with others, wherever b's centre is; two blocks both support the plank that bridges
  them. A contact within 30 degrees of up carries alone. Steeper contacts, up to 80 degrees, carry
  if only together they push up: the sides of a groove, a slope with a wall at its foot. Friction
  and moments are ignored, so only the floor carries a ladder.
- `restsOn(a, b)`: b is on a, or on something that rests on a, and so on.
- `contains(a, b)` and `inside(a, b)` use a's convex hull: a ball between the legs of a table is
  inside it. `enclosed(a, b)` needs walls on both sides along two axes: cups, drawers, shelves and
  rooms enclose; tables, trays and corners do not, nor does a cup a box that it holds by an end.
- `nextTo(a, b)`: a and b are beside each other, neither is on or in the other, and some
  horizontal line through both meets no third body between them. ssduck tries lines in two
  directions, through 26 places each, and may miss a gap that is smaller than what lies between.

## Is it open

`isOpen(e, name)` and `isClosed(e, name)` compare a joint's share of its range. The closed end is
the limit nearer to 0, or the lower one. If the entity has no joint of the name, the error suggests
the nearest one, so a query about several entities must first select those that have it. Raw SQL
evaluates conditions in any order: there the value is NULL for an entity without such a joint. For
past ticks, the table `joints` must have been recorded.

## In SelectScript and in raw SQL

A relation is a function of entities in SelectScript (`above(table, this)`) and a function of rows
of `entities` in raw SQL (`FROM entities a, entities b WHERE above(a, b)`). In raw SQL:

- `on`, `position` and `time` are keywords. Write them in quotes, `"on"(a, b)`, or use their
  second names `onTop(a, b)`, `positionOf(e)`, `timeOf(e)`, which SelectScript knows, too.
- An alias must not be the name of a column: `FROM entities x` hides the row `x` behind it.
- A point is a struct: `inSphere(e, {'x': 0, 'y': 0, 'z': 1}, 0.5)`.
- Every relation may be prefixed with its world: `kitchen.above(a, b)`. With several worlds, those
  that look something up (shapes, contacts, sensings) need the prefix.
- `contains` of two texts is DuckDB's own; for a list or a map, write `list_contains` or
  `map_contains`, also in place of `x IN list`.
- DuckDB lists the relations with `SELECT function_name, comment FROM duckdb_functions()`, and the
  columns with `SELECT table_name, column_name, comment FROM duckdb_columns()`.

## Relations

An `object`, `a` or `b` is an entity, a link or a site, unless the entry says otherwise; arguments
in brackets are optional.
"""

TABLES_HEAD = """# Tables

Each world is a schema of its name (`kitchen.entities`). The tables of the first world are also
available without it (`entities`). All rows are of the world's last tick. `links`, `joints`,
`shapes`, `contacts` and `sensings` are read from the simulator only after a query has used
them.

Metres, seconds, kilograms, newtons, radians; world frame; quaternions w, x, y, z; positions are
those of link frames, not of centres of mass. A row has the `tick` and the `time` of [its
tick](#ticks) but for `geometries`.
"""


def relation_row(relation: Relation) -> str:
    """Returns the row of a relation."""
    unit = relation.unit_note if relation.unit else ""
    symmetric = "The order of the two does not matter." if relation.is_symmetric else ""
    pairs = relation.geometry.pairs if relation.geometry is not None else ""
    calls = f"Calls the narrow phase {pairs}." if pairs else ""
    told = [p for p in relation.parameters if p.meaning not in ("an entity", "another entity")]
    values = "; ".join(f"`{p.name}`: {p.meaning}" for p in told)
    values = f"{values}." if values else ""
    margin = f"Margin: `{relation.margin}`." if relation.margin else ""
    notes = (relation.about, unit, symmetric, calls, margin, relation.alias_note, values)
    return f"| `{relation.usage}` | {' '.join(filter(None, notes))} |"


def relations_page() -> str:
    """Returns the page of the relations, the plain functions and the result forms."""
    lines = [RELATIONS_HEAD.rstrip()]
    for title, family in FAMILIES.items():
        lines += [f"\n### {title}\n", "| relation | meaning |", "|---|---|"]
        others = {r.name: SAME.search(r.about) for r in family if not r.alias_of}
        lines += [relation_row(r) for r in family if not r.alias_of and not others[r.name]]
        same = [f"`{name}` for `{match[1]}`" for name, match in others.items() if match]
        if same:
            lines.append(f"\nOther names: {', '.join(same)}.")
    lines += ["\n## Functions of plain values\n", "| function | meaning |", "|---|---|"]
    told = [function.help.split("\nUsage: ") for function in BUILTINS.values() if function.help]
    operators = [entry for entry in told if OPERATOR.fullmatch(entry[0])]
    lines += [
        f"| `{usage}` | {about} |" for about, usage in told if [about, usage] not in operators
    ]
    names = " ".join(usage.partition("(")[0] for _, usage in operators)
    meanings = ", ".join(about[len("Returns ") : -1] for about, _ in operators)
    lines.append(f"| `{names}` | The operators as functions: {meanings}. |")
    lines += ["\n## Result forms\n", "| AS | result |", "|---|---|"]
    for adapter in all_adapters():
        usage = adapter.usage.replace("|", "\\|")
        lines.append(f"| `{usage}` | {adapter.help} |")
    return "\n".join(lines) + "\n"


def merged(columns: tuple[Column, ...]) -> Iterator[tuple[str, str, str]]:
    """Merges neighbouring columns of one meaning into one row."""
    for (kind, comment), group in groupby(columns, lambda c: (c.type, c.comment)):
        same = list(group)
        seconds = " ".join(column.second_name for column in same if column.second_name)
        also = f"; also {seconds}" if seconds else ""
        yield " ".join(column.name for column in same), kind, comment + also


def tables_page() -> str:
    """Returns the page of the tables."""
    lines = [TABLES_HEAD.rstrip()]
    for table in TABLES.values():
        known = TABLES["links"].shown_columns if table.name == "sites" else ()
        others = " It has the columns of `links`, and these:" if known else ""
        lines += [
            f"\n## `{table.name}`\n",
            f"A row is {table.row}.{others}\n",
            "| columns | type | meaning |",
            "|---|---|---|",
        ]
        columns = merged(tuple(c for c in table.shown_columns if c not in known))
        if table.name != "ticks":
            columns = (row for row in columns if row[0] not in ("tick", "time"))
        lines += [f"| {names} | {kind} | {comment} |" for names, kind, comment in columns]
    return "\n".join(lines) + "\n"


# A generated section of the page of the command line: from its heading to the mark.
SECTION = re.compile(r"## `ssduck (\w+)[^\n]*\n.*?<!-- generated -->\n", re.DOTALL)

# Arguments that the page explains at its beginning.
EXPLAINED = ("SCENE", "RECORD", "SCENE|RECORD", "LAKE")


def parameter_line(parameter: TyperArgument | TyperOption) -> str:
    """Returns the row of an argument or an option of a command."""
    value = ""
    if isinstance(parameter, TyperOption) and not parameter.is_flag:
        value = (parameter.metavar or "").replace("|", "\\|")
    names = sorted((*parameter.opts, *parameter.secondary_opts), key=len)
    if not isinstance(parameter, TyperOption):
        names = [str(parameter.metavar)]
    words = ", ".join(f"`{name}`" for name in names[:-1])
    last = f"`{names[-1]} {value}`" if value else f"`{names[-1]}`"
    shown = getattr(parameter, "show_default", None)
    default = shown if isinstance(shown, str) else parameter.default
    is_named = default is not None and not isinstance(default, bool) and default != ()
    note = f" Default: {default}." if is_named and not parameter.required else ""
    help_text = getattr(parameter, "help", "")
    return f"| {', '.join(filter(None, (words, last)))} | {help_text}{note} |"


def command_section(name: str, command: TyperCommand, said: set[str]) -> str:
    """Returns the heading, the description and the table of a command; rows in `said` by name."""
    arguments = [
        (str(parameter.metavar), parameter.required)
        for parameter in command.params
        if isinstance(parameter, TyperArgument)
    ]
    usage = " ".join(text if required else f"[{text}]" for text, required in arguments)
    about = " ".join((command.help or "").partition("\n\n")[0].split())
    lines = [f"## `{f'ssduck {name} {usage}'.strip()}`\n", about]
    rows: list[str] = []
    known: list[str] = []
    for parameter in command.params:
        is_argument = isinstance(parameter, TyperArgument)
        if is_argument and parameter.metavar in EXPLAINED:
            continue
        if isinstance(parameter, TyperArgument | TyperOption):
            row = parameter_line(parameter)
            (known if row in said else rows).append(row)
    said.update(rows)
    if rows:
        lines += ["", "| argument or option | meaning |", "|---|---|", *rows]
    if known:
        names = [row.split("|")[1].split(",")[-1].split()[0].strip("`") for row in known]
        lines += ["", f"As above: {', '.join(f'`{option}`' for option in names)}."]
    return "\n".join(lines) + "\n"


def command_line_page() -> str:
    """Returns the page of the command line: its marked sections follow the command `ssduck`.

    Raises:
        ValueError: a command has no section, or a section no command.
    """
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    text = (DOCS / "command-line.md").read_text(encoding="utf-8")
    names = SECTION.findall(text)
    if sorted(names) != sorted(commands):
        raise ValueError(
            f"{DOCS / 'command-line.md'}: write a section for each of "
            f"{sorted(commands.keys() - set(names))}, its heading, ## `ssduck NAME`, and the line "
            f"<!-- generated -->; remove those of {sorted(set(names) - commands.keys())}, and "
            "second ones"
        )

    said: set[str] = set()

    def section(match: re.Match[str]) -> str:
        name = match[1]
        return f"{command_section(name, commands[name], said)}<!-- generated -->\n"

    return SECTION.sub(section, text)


def sql_queries_page() -> str:
    """Returns the page of queries that the tests run, each with what it gives."""
    queries = tomllib.loads((TEST_DATA / "sql_queries.toml").read_text(encoding="utf-8"))["query"]
    scene = tomllib.loads((TEST_DATA / "room.toml").read_text(encoding="utf-8"))
    bodies = "".join(
        f"| {body['name']} | {body.get('kind', 'kinbody')} | {body['position']} "
        f"| {body.get('mass', 0)} |\n"
        for body in scene["body"]
    )
    sections = [
        SQL_QUERIES_HEAD,
        f"| name | kind | position, m | mass, kg |\n|---|---|---|---|\n{bodies}",
    ]
    answered = (query for query in queries if not {"error", "warning"} & set(query))
    for group, entries in groupby(answered, key=lambda query: query["group"]):
        rows = query_rows(islice(entries, SHOWN_QUERIES))
        sections.append(f"## {group}\n\n| query | result |\n|---|---|\n{rows}")
    return "\n".join(sections)


def query_rows(queries: Iterable[Mapping[str, str]]) -> str:
    """Returns the lines of a table of queries and what they give."""
    lines = []
    for query in queries:
        cells = (f"`{query['text']}`", f"`{query['value']}`")
        lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |\n")
    return "".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description="Write the manual's generated pages.")
    parser.add_argument("--check", action="store_true", help="only report pages that differ")
    check = parser.parse_args().check
    stale = []
    pages = {
        "relations.md": relations_page(),
        "tables.md": tables_page(),
        "sql-queries.md": sql_queries_page(),
        "command-line.md": command_line_page(),
    }
    for name, text in pages.items():
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
