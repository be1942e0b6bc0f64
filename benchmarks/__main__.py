"""`python -m benchmarks [NAME ...]`: print tables of times and ratios, in Markdown."""

from __future__ import annotations

import platform
import sys
from collections.abc import Iterable

from benchmarks import language, queries, ticks

TABLES = {"ticks": ticks, "queries": queries, "language": language}


def printed(header: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> None:
    """Print a Markdown table, a row as soon as it is measured."""
    print("| " + " | ".join(header) + " |")
    print("|" + "---|" * len(header))
    for row in rows:
        print("| " + " | ".join(row) + " |", flush=True)
    print()


def main() -> None:
    """Run the benchmarks that are named, or all."""
    names = sys.argv[1:] or list(TABLES)
    unknown = [name for name in names if name not in TABLES]
    if unknown:
        sys.exit(f"no benchmark {', '.join(unknown)}; there are {', '.join(TABLES)}")
    print(f"Python {platform.python_version()}, {platform.machine()}\n")
    for name in names:
        printed(TABLES[name].HEADER, TABLES[name].rows())


if __name__ == "__main__":
    main()
