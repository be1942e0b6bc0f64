"""Rewrites the SQL and the results in the test cases of the language, tests/data/language.toml.

`python -m tools.write_cases` takes some seconds. Review the difference before committing it: the
tests compare with the file.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pandas as pd

import ssduck
from ssduck.interpreter import query_runner as queries

CASES = Path(__file__).resolve().parent.parent / "tests" / "data" / "language.toml"
PREPARATION = """
    table = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;
    low = 1.5; wanted = 'microwave'; one = 1; apart = [[a.this, b.this]];
    things = SELECT obj FROM kitchen WHERE isRobot(this) AS list;
"""


def height(entity: ssduck.Entity) -> float:
    """Returns the height of an entity's box."""
    return entity.aabb[1][2] - entity.aabb[0][2]


def prepared() -> ssduck.Interpreter:
    """Returns an interpreter with the kitchen, variables and functions of the cases."""
    ss = ssduck.load("kitchen")
    ss.add_function("tall", lambda entity: height(entity) > 1.0)
    ss.add_function("height", height)
    ss.eval(PREPARATION)
    ss.add_variable("people", [{"name": "Ada", "age": 36}, {"name": "Alan", "age": 24}])
    ss.add_variable("frame", pd.DataFrame({"name": ["Ada", "Alan"], "age": [36, 24]}))
    return ss


def cases() -> list[dict[str, str]]:
    """Returns the cases: title, program, SQL in one line, value."""
    table: list[dict[str, str]] = tomllib.loads(CASES.read_text(encoding="utf-8"))["case"]
    return table


def sql_of(ss: ssduck.Interpreter, program: str) -> str:
    """Returns the SQL of a program in one line."""
    return " ".join(ss.explain(program).split())


def _to_toml(case: dict[str, Any]) -> str:
    lines = [f"{key} = '''{case[key]}'''" for key in ("of", "program", "sql", "value")]
    return "\n".join(["[[case]]", *lines])


def main() -> None:
    """Writes the file."""
    queries.FEW_ROWS = 0
    with prepared() as ss:
        all_cases = cases()
        for case in all_cases:
            case["sql"] = sql_of(ss, case["program"])
            case["value"] = repr(ss.eval(case["program"]))
    CASES.write_text("\n\n".join(map(_to_toml, all_cases)) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
