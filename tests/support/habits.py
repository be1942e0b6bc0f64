"""Interpreters for the tests of SQL's spellings."""

import ssduck

PEOPLE = [
    {"name": "Ada", "age": 36, "group": "a"},
    {"name": "Bob", "age": None, "group": "b"},
    {"name": "Cy", "age": 24, "group": "a"},
]


def _interpreter(world, **options):
    made = ssduck.Interpreter(recording=None, **options)
    made.add_variable("kitchen", world)
    made.add_variable("people", PEOPLE)
    made.add_variable("ints", [3, 1, 2, 1])
    made.add_function("pairs", lambda value: [value, value])
    return made


OF_ROWS = {
    "count(*)": len,
    "COUNT(*)": len,
    "count(1)": len,
    "count(id)": len,
    "count(this)": len,
    "count(position)": len,
    "sum(1)": len,
    "sum(z)": lambda rows: sum(z for _, z in rows),
    "min(z)": lambda rows: min(z for _, z in rows),
    "max(z) - min(z) + 1": lambda rows: max(z for _, z in rows) - min(z for _, z in rows) + 1,
    "avg(z * 2)": lambda rows: sum(z * 2 for _, z in rows) / len(rows),
    "max(id)": lambda rows: max(name for name, _ in rows),
    "count(uniq(z))": lambda rows: len({z for _, z in rows}),
    "count(DISTINCT z)": lambda rows: len({z for _, z in rows}),
    "uniq(type)": lambda _: None,
    "IF(count(*) > 5; 'many'; 'few')": lambda rows: "many" if len(rows) > 5 else "few",
    "max([count(*), 10])": lambda rows: max(len(rows), 10),
    "count(ints)": lambda _: 4,
}
