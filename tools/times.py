"""Reports what the tests of the last run took, and finds cases that take too long.

`python -m tools.times` prints, of what pytest ran last, the seconds of each package, and its twenty
dearest cases and fixtures. A case that took more than three seconds is run again, alone; if it
does again, the exit status is 1: mark it `long`, or make it quicker. `make times` runs all but the
`long` ones first.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tests.support.times import TIMES

ROOT = Path(__file__).resolve().parents[1]
CACHE = ROOT / ".pytest_cache" / "v" / TIMES
MOST = 20
# What a case may take, in seconds.
LIMIT = 3.0


def package(name: str) -> str:
    """Returns the folder of the tests that a case or a fixture belongs to."""
    parts = name.partition("::")[0].split("/")
    return parts[1] if len(parts) > 2 else "tests"


def rows(named: dict[str, Any]) -> Iterable[str]:
    """Yields the lines of the report."""
    calls: dict[str, float] = named["calls"]
    fixtures: dict[str, list[float]] = named["fixtures"]
    cases: Counter[str] = Counter(map(package, calls))
    of_calls: Counter[str] = Counter()
    of_fixtures: Counter[str] = Counter()
    for name, seconds in calls.items():
        of_calls[package(name)] += seconds  # type: ignore[assignment]
    for name, times in fixtures.items():
        of_fixtures[package(name)] += sum(times)  # type: ignore[assignment]
    yield f"{'package':14} {'cases':>6} {'calls':>8} {'fixtures':>8}"
    for name, count in cases.most_common():
        yield f"{name:14} {count:6} {of_calls[name]:6.1f} s {of_fixtures[name]:6.1f} s"
    total = sum(calls.values()), sum(of_fixtures.values())
    yield f"{'all':14} {len(calls):6} {total[0]:6.1f} s {total[1]:6.1f} s"
    yield "\nThe dearest cases:"
    for name, seconds in Counter(calls).most_common(MOST):
        yield f"{seconds:6.1f} s  {name}"
    yield "\nThe dearest fixtures, in all processes:"
    dearest = sorted(fixtures.items(), key=lambda item: -sum(item[1]))
    for name, times in dearest[:MOST]:
        yield f"{sum(times):6.1f} s  {name}, {len(times)} times"


def seconds_alone(case: str) -> float:
    """Runs a case alone, and returns its seconds."""
    with tempfile.TemporaryDirectory() as cache:
        command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "-m", "", case]
        command += ["-o", f"cache_dir={cache}"]
        subprocess.run(command, cwd=ROOT, stdout=subprocess.DEVNULL, check=False)  # noqa: S603
        times = json.loads((Path(cache) / "v" / TIMES).read_text(encoding="utf-8"))
    return float(times["calls"][case])


def main() -> int:
    try:
        last = CACHE.read_text(encoding="utf-8")
    except FileNotFoundError:
        print("pytest has not run yet; run `make check` first")
        return 1
    named = json.loads(last)
    print("\n".join(rows(named)))
    dear = [case for case, seconds in named["calls"].items() if seconds > LIMIT]
    again = {case: seconds_alone(case) for case in dear}
    too_long = {case: seconds for case, seconds in again.items() if seconds > LIMIT}
    for case, seconds in too_long.items():
        print(f"\n{case} takes {seconds:.1f} s, more than {LIMIT:.0f}: make it quicker, or `long`")
    return int(bool(too_long))


if __name__ == "__main__":
    sys.exit(main())
