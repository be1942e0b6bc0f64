"""Runs benchmarks and prints tables of times and ratios in Markdown.

`python -m benchmarks [NAME ...]` runs the short ones, or those named: ticks, queries, triggers,
language and adapters. All of them take some minutes, and so do the tables raw, strict,
checksums, first and interchange. The tables mujoco and logic need MuJoCo, gym and batches gymnasium
as well, and view websockets.
`python -m benchmarks lake [FOLDER]` needs gymnasium and MuJoCo, and Ray and Spark for their rows.
`python -m benchmarks pairs [OPTION ...]` and `python -m benchmarks time [OPTION ...]` take many
minutes; `--help` lists their options.
"""

from __future__ import annotations

import platform
import sys

from benchmarks import (
    adapters,
    batches,
    checksums,
    first_questions,
    gym_steps,
    interchange,
    lake,
    language,
    logic,
    mujoco_ticks,
    pair_relations,
    pairs,
    queries,
    raw,
    recorded,
    strict,
    ticks,
    triggers,
    view,
)
from benchmarks.timing import print_table

TABLES = {
    "ticks": ticks,
    "queries": queries,
    "triggers": triggers,
    "language": language,
    "adapters": adapters,
}
# Tables that take minutes.
LONG_TABLES = {
    "raw": raw,
    "strict": strict,
    "checksums": checksums,
    "first": first_questions,
    "interchange": interchange,
}
# Tables that need an extra.
EXTRA_TABLES = {
    "batches": batches,
    "gym": gym_steps,
    "logic": logic,
    "mujoco": mujoco_ticks,
    "view": view,
}
LONG = {
    "lake": lake.main,
    "pairs": pairs.main,
    "relations": pair_relations.main,
    "time": recorded.main,
}


def main() -> None:
    """Runs the named benchmarks, or all short ones."""
    print(f"Python {platform.python_version()}, {platform.machine()}\n")
    if sys.argv[1:] and sys.argv[1] in LONG:
        sys.exit(LONG[sys.argv[1]](sys.argv[2:]))
    names = sys.argv[1:] or list(TABLES)
    tables = TABLES | LONG_TABLES | EXTRA_TABLES
    unknown = [name for name in names if name not in tables]
    if unknown:
        sys.exit(f"no benchmark {', '.join(unknown)}; there are {', '.join([*tables, *LONG])}")
    for name in names:
        print_table(tables[name].HEADER, tables[name].rows())


if __name__ == "__main__":
    main()
