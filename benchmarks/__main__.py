"""`python -m benchmarks [NAME ...]`: print tables of times and ratios, in Markdown.

`python -m benchmarks pairs [OPTION ...]` and `time [OPTION ...]` are of their own: they take
minutes, and options.
"""

from __future__ import annotations

import platform
import sys

from benchmarks import adapters, language, pairs, queries, recorded, ticks
from benchmarks.timing import printed

TABLES = {"ticks": ticks, "queries": queries, "language": language, "adapters": adapters}
LONG = {"pairs": pairs.main, "time": recorded.main}


def main() -> None:
    """Run the benchmarks that are named, or all."""
    print(f"Python {platform.python_version()}, {platform.machine()}\n")
    if sys.argv[1:] and sys.argv[1] in LONG:
        sys.exit(LONG[sys.argv[1]](sys.argv[2:]))
    names = sys.argv[1:] or list(TABLES)
    unknown = [name for name in names if name not in TABLES]
    if unknown:
        sys.exit(f"no benchmark {', '.join(unknown)}; there are {', '.join([*TABLES, *LONG])}")
    for name in names:
        printed(TABLES[name].HEADER, TABLES[name].rows())


if __name__ == "__main__":
    main()
