"""Writes a record without ssduck: a ball that falls on a floor.

`python examples/plain_record.py` needs pyarrow alone. It writes the folder `fallen`, which
`ssduck.open` answers as any record; docs/reference/record-format.md describes the files.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from uuid import uuid4

import pyarrow as pa
import pyarrow.parquet as pq

run = Path("fallen")
world, episode, key = "lab", 0, uuid4().hex
(run / "episodes").mkdir(parents=True)
(run / "ssduck.json").write_text(json.dumps({"format": "ssduck record", "version": 1}))

TYPES = {"integer": pa.int64(), "real": pa.float64(), "text": pa.string(), "flag": pa.bool_()}
TYPES["points"] = pa.list_(pa.list_(pa.float64(), 3))
TYPES["triples"] = pa.list_(pa.list_(pa.int32(), 3))


def write(table: str, rows: Sequence[Mapping[str, object]], **names: str) -> None:
    """Writes part 0 of a table; `names` are those of its columns, by type."""
    columns = {name: TYPES[kind] for kind, some in names.items() for name in some.split()}
    place = run / table / f"world={world}" / f"episode={episode}"
    place.mkdir(parents=True)
    label = json.dumps({"episode": key, "table": table, "part": 0})
    written = pa.Table.from_pylist(rows, pa.schema(columns, {"ssduck record": label}))
    pq.write_table(written, place / ".part-000000.parquet")
    (place / ".part-000000.parquet").rename(place / "part-000000.parquet")


POSE, TWIST, BOX = "x y z qw qx qy qz", "vx vy vz wx wy wz", "xmin ymin zmin xmax ymax zmax"
HERE = dict(zip(POSE.split(), [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], strict=True))
# id, name, mass; type and size of the shape; half of its box
BODIES = [
    (1, "floor", 0.0, ("box", 4.0, 4.0, 0.2), (2.0, 2.0, 0.1)),
    (2, "ball", 0.5, ("sphere", 0.1, 0.0, 0.0), (0.1, 0.1, 0.1)),
]

# the models: the entities last
write(
    "models/links",
    [{"entity": id, "link": 0, "name": name, "mass": mass} for id, name, mass, *_ in BODIES],
    integer="entity link parent",
    text="name region",
    real="mass region_x region_y region_z",
)
write(
    "models/joints",
    [],
    integer="entity joint link",
    text="name type",
    real="lower upper max_effort max_velocity axis_x axis_y axis_z "
    "anchor_x anchor_y anchor_z reference",
)
write(
    "models/geometries",
    [
        dict(
            zip(("id", "type", "size_x", "size_y", "size_z"), (id, *form), strict=True),
            vertices=[],
            faces=[],
        )
        for id, _, _, form, _ in BODIES
    ],
    integer="id",
    text="type",
    real="size_x size_y size_z",
    points="vertices",
    triples="faces",
)
shape = {"link": 0, "shape": 0, **HERE, "margin": 0.0, "exact": True}
write(
    "models/shapes",
    [{"entity": id, "geometry": id, **shape} for id, *_ in BODIES],
    integer="entity link shape geometry",
    real=f"{POSE} margin",
    flag="exact",
)
write(
    "models/entities",
    [
        {"id": id, "name": name, "kind": "kinbody", "mass": mass, "links": 1, "joints": 0}
        | {"movable": mass > 0, "run": 4711}
        for id, name, mass, *_ in BODIES
    ],
    integer="id links joints host host_link run",
    text="name kind parent sensor visuals",
    real="mass",
    flag="movable",
)

# the ticks: `ticks` last
times = {tick: (tick - 1) / 10 for tick in range(1, 6)}
rows = []
for tick, time in times.items():
    for id, name, mass, _, half in BODIES:
        centre = (0.0, 0.0, -0.1 if name == "floor" else 1.0 - 4.9 * time**2)
        low = [c - h for c, h in zip(centre, half, strict=True)]
        high = [c + h for c, h in zip(centre, half, strict=True)]
        row = {"tick": tick, "time": time, "id": id, "name": name, "kind": "kinbody", **HERE}
        row |= {"z": centre[2], **dict(zip(BOX.split(), low + high, strict=True)), "mass": mass}
        rows.append(row | {"enabled": True, "visible": True, "run": 4711})
write(
    "entities",
    rows,
    integer="tick id run",
    text="name kind parent",
    real=f"time {POSE} {TWIST} {BOX} mass",
    flag="enabled visible",
)
ticks = [{"tick": tick, "time": time} for tick, time in times.items()]
write("ticks", ticks, integer="tick", real="time wall_time")
about = {
    "world": world,
    "episode": episode,
    "id": str(uuid4()),
    "key": key,
    "tables": ["ticks", "entities"],
    "started": "2026-01-01T12:00:00+00:00",
    "recording": {"every": 1, "entities": None},
    "tags": {"task": "fall"},
    "parts": {"ticks": 1, "models": 1},
}
(run / "episodes" / f"{world}-{episode}.json").write_text(json.dumps(about))
