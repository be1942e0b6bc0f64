"""Records a run as small as `ssduck demo cleanup` can tell it, which ships such a record."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from examples.cleanup.program import clean
from ssduck.demos.cleanup import Outcome
from ssduck.errors import SelectScriptError
from ssduck.interpreter.interpreter import Interpreter
from ssduck.recording.spec import Recording
from ssduck.recording.stores.files import write_json, write_parquet

# Of the ticks of the history, which are 0.27 s apart, each fourth one is kept.
THINNED = 4
# What no question of the demonstration needs; NULL takes no room.
UNNEEDED = ("vx", "vy", "vz", "wx", "wy", "wz", "velocity", "effort")


def record(
    ss: Interpreter, folder: Path | None, say: Callable[[str], None], target: Path, *, seed: int
) -> Outcome:
    """Cleans up as `clean` does, and writes a record of the run.

    The record has the poses of bodies, and the positions of joints, about once a second and at the
    ticks of the events, which are its tags: those in which something is asked or drawn, and that of
    the deepest penetration. So the answers are those of the whole run.

    Args:
        ss: an interpreter with the world `kitchen`.
        folder: the folder for pictures; None for none.
        say: writes lines of the report.
        target: the new folder of the record.
        seed: the seed of the planners' random numbers.

    Raises:
        SelectScriptError: not all went well, or the folder exists.
    """
    if target.exists():
        raise SelectScriptError(f"{target} exists: choose another folder for the record")
    with TemporaryDirectory() as temporary:
        whole = Path(temporary) / "run"
        bodies = tuple(entity.name for entity in ss.worlds[0] if entity.kind != "sensor")
        spec = Recording(tables=("entities", "joints"), entities=bodies)
        with ss.record_to(whole, recording=spec) as recording:
            outcome = clean(ss, folder, say, seed=seed)
            if outcome.trouble or not outcome.succeeded:
                raise SelectScriptError("not all went well: the run is not recorded")
            recording.tag({"seed": seed, **outcome.events})
        rows = ss.sql("SELECT tick FROM ticks_history ORDER BY tick").fetchall()
        ticks = {tick for (tick,) in rows[::THINNED]}
        thin(whole, target, {*ticks, *outcome.events.values(), ss.worlds[0].tick_number})
    return outcome


def thin(whole: Path, target: Path, ticks: Collection[int]) -> None:
    """Writes some ticks of a record to another folder, each table as one part.

    Args:
        whole: the record, of one episode.
        target: the new folder.
        ticks: the numbers of the ticks.
    """
    target.mkdir(parents=True)
    (target / "ssduck.json").write_bytes((whole / "ssduck.json").read_bytes())
    (description,) = (whole / "episodes").iterdir()
    episode = json.loads(description.read_text(encoding="utf-8"))
    episode["parts"] = {"ticks": 1, "models": 1}
    for folder in sorted({file.parent for file in whole.rglob("part-*.parquet")}):
        if folder.relative_to(whole).parts[0] == "index":
            continue
        rows = pa.concat_tables(map(pq.read_table, sorted(folder.glob("part-*.parquet"))))
        place = target / folder.relative_to(whole) / "part-000000.parquet"
        place.parent.mkdir(parents=True)
        _write(rows, place, ticks)
    (target / "episodes").mkdir()
    write_json(episode, target / "episodes" / description.name)


def _write(rows: pa.Table, place: Path, ticks: Collection[int]) -> None:
    if "tick" in rows.column_names:
        rows = rows.filter(np.isin(rows["tick"].to_numpy(), list(ticks)))
    for name in set(UNNEEDED) & set(rows.column_names):
        index = rows.column_names.index(name)
        rows = rows.set_column(index, name, pa.nulls(len(rows), pa.float64()))
    label = {key: text for key, text in rows.schema.metadata.items() if key == b"ssduck record"}
    rows = rows.replace_schema_metadata(label)
    write_parquet(rows, place, compression="zstd", compression_level=19, write_statistics=False)
