"""Asks a lake of fifty episodes which of them failed, and how.

`python examples/find_failures.py` needs ssduck alone. It records episodes in `pushes`: a puck is
pushed across a table with a random speed, and has to stop in the last third of it. It asks all of
them at once, and prints a table of those that failed, from the slowest push to the fastest.
"""

from __future__ import annotations

import random
from pathlib import Path

import ssduck

SCENE = """
floor = true

[[body]]
name = "table"
box = [1.2, 0.6, 0.4]
position = [0.0, 0.0, 0.2]
fixed = true

[[body]]
name = "puck"
box = [0.08, 0.08, 0.04]
mass = 0.2
position = [-0.5, 0.0, 0.42]
velocity = [{speed}, 0, 0, 0, 0, 0]
"""
EVERY_FOURTH = ssduck.Recording(tables=("links",), every=4)
# What became of the puck, where it is at the end, and since when it is off the table.
QUESTION = """
    SELECT CASE WHEN NOT on(room.table, this) THEN 'fell' WHEN x < 0.2 THEN 'short' ELSE '' END
        AS why, x, since(NOT on(room.table, this)) AS off FROM room WHERE id = 'puck';
"""


def record(folder: Path, count: int) -> None:
    """Records episodes, each tagged with the speed of its push."""
    rng = random.Random(1)
    for _ in range(count):
        speed = round(rng.uniform(1.4, 2.8), 3)
        (folder / "room.toml").write_text(SCENE.format(speed=speed))
        with ssduck.load(folder / "room.toml") as ss:
            ss.record_to(folder / "runs", recording=EVERY_FOURTH, tags={"speed": speed})
            ss["room"].run(1.5)


def main(folder: str = "pushes", count: int = 50) -> None:
    """Records the episodes unless they are there, and lists those that failed."""
    Path(folder).mkdir(exist_ok=True)
    if not (Path(folder) / "runs").exists():
        record(Path(folder), count)
    lake = ssduck.lake(f"{folder}/runs")
    tags = lake.episodes.select(["episode", "speed"]).to_pylist()
    speeds = {row["episode"]: row["speed"] for row in tags}
    failed = [row for row in lake.ask(QUESTION).to_pylist() if row["why"]]
    print(f"{len(failed)} of {len(speeds)} failed")
    for row in sorted(failed, key=lambda row: speeds[row["episode"]]):
        off = "" if row["off"] is None else f", off the table at {row['off']:.3f} s"
        speed = speeds[row["episode"]]
        print(f"{row['why']:5} {row['episode']:3} {speed:.3f} m/s, x = {row['x']:.3f} m{off}")


if __name__ == "__main__":
    main()
