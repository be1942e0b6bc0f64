"""Write the manual's pages that come from the code: `python tools/write_reference.py [--check]`.

`docs/reference/relations.md` comes from the registry of relations and functions,
`docs/reference/tables.md` from the declarations of the tables. With `--check` nothing is written,
and the exit status is 1 if a page differs.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

from ssduck.adapters.registry import forms
from ssduck.language.builtins import BUILTINS
from ssduck.schema import TABLES, Column
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.relations.relation import Relation

DOCS = Path(__file__).resolve().parent.parent / "docs" / "reference"

RELATIONS_HEAD = '''# Relations and functions

Metres, newtons, radians, kilograms; world frame; quaternions w, x, y, z. A relation of an entity
with itself is False, a distance 0. An unknown value, of a body whose pose is no number, is NULL
(None in Python), never NaN: no condition on it holds in SQL, nor does its opposite. What Python
evaluates takes None for false, and cannot compare it.

## Boxes and shapes

`above`, `below`, `within`, `overlaps`, `volume` and `aabbVolume` are of positions and axis-aligned
boxes: formulas over columns, and fast. The relations that say `Asks the narrow phase` are of the
shapes themselves: two balls side by side may overlap and yet be apart. DuckDB then calls Python,
but only for the pairs that are said there, wherever the relation stands: in `WHERE` and `SELECT`,
under `NOT` and in `OR`. A pair is compared once a tick, however often it is asked for. `clearance`
compares every pair that it is asked for; where a distance will do, `near(a, b, d)` is cheaper.

Of two sources that are one world, `collides`, `near`, `touching`, `on`, `supports`, `restsOn`,
`contains` and `enclosed` in the WHERE of a SelectScript query find all of the tick's pairs at once:
`collides` takes milliseconds for a thousand bodies. In raw SQL, DuckDB compares the boxes of every
row with those of every other one, which from some 3,000 bodies on takes longer than the shapes do;
the pairs are there as tables, too:

```python
import ssduck

ss = ssduck.load("kitchen")
ss.sql("""
    SELECT e.name, f.name
    FROM colliding_pairs() p JOIN entities e ON e.id = p.a JOIN entities f ON f.id = p.b
""")
ss.sql("SELECT a, b FROM kitchen.pairs_within(0.02) WHERE a < b")  # of clearances, in metres
ss.sql("SELECT a, b FROM colliding_pairs(0.001)")  # deeper than a millimetre in each other
```

An entity is all its shapes, those of all its links: a relation of two holds for their closest
shapes. A plane is a solid half-space: what is under the ground collides with it. A closed mesh is
solid, an open one a surface. What has no shapes, a sensor say, meets nothing and is infinitely far
from all. What is disabled or not drawn has its shapes as before. The rows of `entities` that are
compared are of one tick: the current one, or a recorded one (see [Time](time.md)).

```python
import ssduck

ss = ssduck.load("kitchen")
kitchen = ss.call_variable("kitchen").step(480)  # two seconds, until all is at rest
ss.eval("""
    table = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;
    SELECT id FROM kitchen WHERE on(table, this) AS list;
""")  # four cups and three plates, and no chair
ss.eval("SELECT id FROM kitchen WHERE contains(this, var('table')) AS list;")  # ['kitchen']
ss.eval("SELECT id, clearance(table, this) FROM kitchen WHERE near(table, this, 0.5);")
ss.sql("SELECT a.name, b.name, penetration(a, b) FROM entities a, entities b WHERE collides(a, b)")
print(ss.statistics()["kitchen"])  # how many pairs that took, and how many calls
```

## Rest and intrusion

Simulators do not let things rest surface on surface. PyBullet presses boxes, balls, cylinders and
capsules into what they rest on by 0.01 to 0.02 mm, and keeps hulls and concave meshes away from it
by a margin of 1 mm each: so a cup of hulls on a plate of hulls has a clearance of 1.99 mm. Each
shape's margin is in the table of shapes (`margin`), as the simulator has it at the tick; records
keep the one that the body came with. What to ask for:

| question | ask |
|---|---|
| does b rest on a? | `on(a, b)`, margins included |
| do they touch? | `touching(a, b)`, margins included |
| are they pressed together? | `inContact(a, b)`: the solver found a force |
| how near are the surfaces? | `clearance(a, b)`, `near(a, b, d)`: of the shapes alone |
| is one in the other? | `collides(a, b, 1e-3)`: deeper than 1 mm; `collides(a, b)` may only rest |

`clearance`, `penetration`, `contactForce` and `nearestPoints` of (a, b) and of (b, a) are the same
to the last bit, and so they are of the present, of recorded ticks and of opened records.

## On, in and beside

These are told by shapes and poses alone, so that they are the same live, at a past tick, in a
record and in a what-if world. What the physics solver found is `inContact` and `contactForce`.

- `on(a, b)`: b stands on a by itself, for its centre is over a. `supports(a, b)`: a carries b,
  maybe with others, and b's centre may be anywhere: both blocks support the plank that bridges
  them. Contacts within 30 degrees of up carry alone. Steeper ones, up to 80 degrees, carry where
  they need each other to push up: the sides of a groove, three balls under a fourth, a slope where
  a wall holds against it. Friction and moments are not looked at, so that a ladder is carried by
  the floor only.
- `restsOn(a, b)`: b is on a, or on something that rests on a, and so on.
- `contains(a, b)` and `inside(a, b)` are of a's convex hull: a ball between the legs of a table is
  in it. `enclosed(a, b)` asks for walls: rays from the centre of b's box meet a on both sides along
  two of a's three axes at least. Cups, drawers, shelves and rooms enclose; a table, a tray and a
  corner do not. Rays meet the surfaces of meshes from within, too, but no convex shape that they
  begin in: of two blocks in each other neither is enclosed. So that a box is not in the cup that it
  holds, an axis along which b reaches past a at both ends does not count.
- `nextTo(a, b)`: beside each other, on nothing of each other's and in nothing, and with nothing
  between them: on some horizontal line that runs through both, no third body is between. The lines
  run along the connection of the nearest points and along that of the boxes' centres, through the
  nearest points and through 25 places over the breadth and the height that both have in common; a
  gap that is smaller than the space between these may be missed.

```python
import ssduck

ss = ssduck.load("kitchen")
kitchen = ss.call_variable("kitchen").step(480)
ss.eval("""
    plate = SELECT obj FROM kitchen WHERE id(this) == 'plate_b4e7' AS value;
    SELECT id FROM kitchen WHERE enclosed(this, plate) AS list;
""")  # ['microwave'], while its hull and the kitchen's contain it
ss.eval("SELECT id FROM kitchen WHERE supports(this, plate) OR restsOn(this, plate) AS list;")
ss.eval("""
    SELECT id(a.this), id(b.this) FROM a=kitchen, b=kitchen WHERE nextTo(a.this, b.this) AS list;
""")
```

## Is it open

`joint(e, name)` is where a joint is, in radians or metres. `isOpen(e, name)` checks if it is open
by half of its range, `isClosed(e, name)` if it is open by a 20th at most; another share may be
given. The closed end is that of the two limits that is nearer to 0, or the lower one. Without a
name, any joint that has limits is to be open, or all of them closed; what has none is neither. A
name that the entity has no joint of is an error that tells the nearest one; so a query of several
entities says first which are meant. In raw SQL, whose conditions come in no order, it is NULL of an
entity without such a joint, and an error where no entity of the world has one. In Python,
`entity.joints` tells of each joint its `position` and its `openness`. Of a past tick they are known
if the table `joints` was recorded.

```python
import ssduck

ss = ssduck.load("kitchen")
ss.eval("""
    SELECT joint(this, 'f1'), isOpen(this, 'f1'), isClosed(this, 'f1', 0.2)
    FROM kitchen WHERE id(this) == 'barrett_4918';
""")
ss.sql("SELECT name FROM entities e WHERE isOpen(e, 'f1', 0.1)").fetchall()  # [('barrett_4918',)]
```

## In SelectScript and in raw SQL

A relation is a function of entities in SelectScript (`above(table, this)`) and a function of rows
of `entities` in raw SQL (`FROM entities a, entities b WHERE above(a, b)`). In raw SQL:

- `on`, `position` and `time` are words of SQL's: they are written in quotes, `"on"(a, b)`, or by
  their second names, `onTop(a, b)`, `positionOf(e)`, `timeOf(e)`, which SelectScript knows, too.
- An alias must not be the name of a column: `FROM entities x` hides the row `x` behind the column.
- A point is a struct: `inSphere(e, {'x': 0, 'y': 0, 'z': 1}, 0.5)`.
- Every relation may have its world before it: `kitchen.above(a, b)`. What looks something up
  (shapes, contacts, sensings) is for one world. With several worlds, write the one that is meant;
  rows of another run (see the column `run`) are an error:
  `FROM kitchen.entities a, kitchen.entities b WHERE kitchen.collides(a, b)`.
- `contains` of two texts is DuckDB's own; of a list or a map, write `list_contains` or
  `map_contains`.
- DuckDB lists what they do: `SELECT function_name, comment FROM duckdb_functions()`; what columns
  hold: `SELECT table_name, column_name, comment FROM duckdb_columns()`.

## Relations
'''

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
    symmetric = " The order of the two does not matter." if relation.is_symmetric else ""
    pairs = relation.geometry.pairs if relation.geometry is not None else ""
    asked = f" Asks the narrow phase {pairs}." if pairs else ""
    others = f" {relation.alias_note}" if relation.alias_note else ""
    yield f"{relation.about}{unit}{symmetric}{asked}{others}\n"
    for parameter in relation.parameters:
        yield f"- `{parameter.name}`: {parameter.meaning}"


def relations_page() -> str:
    """The page of the relations, the plain functions and the result forms."""
    lines = [RELATIONS_HEAD.rstrip()]
    for relation in RELATIONS.values():
        if not relation.alias_of:
            lines += relation_lines(relation)
    lines += ["\n## Functions of plain values\n", "| function | what it does |", "|---|---|"]
    for function in BUILTINS.values():
        about, usage = function.help.split("\nUsage: ")
        lines.append(f"| `{usage}` | {about} |")
    lines += ["\n## Result forms\n", "| AS | what it gives |", "|---|---|"]
    for adapter in forms():
        usage = adapter.usage.replace("|", "\\|")
        lines.append(f"| `{usage}` | {adapter.help} |")
    return "\n".join(lines) + "\n"


def merged(columns: tuple[Column, ...]) -> Iterator[tuple[str, str, str]]:
    """Neighbouring columns of one meaning as one row."""
    for (kind, comment), group in groupby(columns, lambda c: (c.type, c.comment)):
        same = list(group)
        seconds = " ".join(column.second_name for column in same if column.second_name)
        also = f"; also {seconds}" if seconds else ""
        yield " ".join(column.name for column in same), kind, comment + also


def tables_page() -> str:
    """The page of the tables."""
    lines = [TABLES_HEAD.rstrip()]
    for table in TABLES.values():
        lines += [
            f"\n## `{table.name}`\n",
            f"A row is {table.row}.\n",
            "| columns | type | meaning |",
            "|---|---|---|",
        ]
        columns = merged(table.columns)
        lines += [f"| {names} | {kind} | {comment} |" for names, kind, comment in columns]
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
