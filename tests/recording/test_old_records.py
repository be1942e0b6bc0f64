"""Records of earlier formats open, with the answers that PyBullet gave when they were recorded.

`python -m tools.write_records` writes such records, and those of the present format.
"""

from __future__ import annotations

import json
import shutil
import tarfile
from dataclasses import replace
from pathlib import Path
from typing import Any
from uuid import UUID

import pyarrow.parquet as pq
import pytest

import ssduck
from ssduck.errors import RecordError
from ssduck.recording.stores.stored_columns import part_columns
from ssduck.schema import MODELS, RECORDABLE, RECORDED
from tests.support.cases import sampled

DATA = Path(__file__).parents[1] / "data"
KINDS = ("run", "run.duckdb", "unfinished")
POSE = "x, y, z, qw, qx, qy, qz"


@pytest.fixture(scope="module", params=sorted(file.name for file in DATA.glob("records-*.tar.xz")))
def records(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the records, unpacked."""
    place = tmp_path_factory.mktemp("old")
    with tarfile.open(DATA / request.param) as packed:
        packed.extractall(place, filter="data")
    return place


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_an_old_record_has_the_same_answers(records: Path, kind: str) -> None:
    assert_answers(records, records / kind)


@pytest.mark.slow
@sampled("kind", KINDS, every=3)
def test_an_upgraded_record_has_them_too_and_is_of_the_present_format(
    records: Path, kind: str, tmp_path: Path
) -> None:
    (old,) = [episode for episode in ssduck.episodes(records / kind) if episode.ticks]
    before = {file: file.read_bytes() for file in records.rglob("*") if file.is_file()}
    (new,) = ssduck.upgrade(records / kind, tmp_path / "new")
    assert {file: file.read_bytes() for file in before} == before
    assert_answers(records, tmp_path / "new")
    ignored = {"path": None, "id": None, "complete": None}
    assert replace(new, **ignored) == replace(old, **ignored)
    assert (new.complete, UUID(new.id).version) == (True, 4)
    about = json.loads((tmp_path / "new" / "episodes" / "lab-0.json").read_text())
    assert about["checksums"] == "crc32"
    assert ssduck.check(tmp_path / "new") == []
    for table in (*RECORDED, *(f"models/{name}" for name in MODELS)):
        for file in (tmp_path / "new" / table).rglob("*.parquet"):
            assert set(pq.read_schema(file).names) >= set(part_columns(table)), table
    # A second upgrade changes nothing, ids included.
    (again,) = ssduck.upgrade(tmp_path / "new", tmp_path / "again")
    assert replace(again, path=None) == replace(new, path=None)
    with ssduck.open(tmp_path / "new") as first, ssduck.open(tmp_path / "again") as second:
        for table in (*RECORDABLE, "ticks"):
            query = f"SELECT * FROM lab.{table}_history ORDER BY ALL"
            assert first.sql(query).fetchall() == second.sql(query).fetchall()


def test_what_cannot_be_upgraded_is_an_error(records: Path, tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="is there already"):
        ssduck.upgrade(records / "run", records)
    with pytest.raises(RecordError, match="there is no record"):
        ssduck.upgrade(records / "nothing", tmp_path / "new")
    later = tmp_path / "later"
    shutil.copytree(records / "run", later)
    about = json.loads((later / "ssduck.json").read_text())
    about.pop("crc32", None)
    (later / "ssduck.json").write_text(json.dumps(about | {"version": 2}))
    with pytest.raises(RecordError, match="install a newer one"):
        ssduck.upgrade(later, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def assert_answers(records: Path, place: Path) -> None:
    """Checks what a record of the small world says against what PyBullet said."""
    expected: list[dict[str, Any]] = json.loads((records / "expected.json").read_text("utf-8"))
    ticks = [told["tick"] for told in expected]
    with ssduck.open(place) as ss:
        assert ss.past("lab").ticks[-len(ticks) :] == ticks

        def rows(columns: str, table: str, condition: str = "true") -> list[list[float]]:
            found = ss.sql(
                f"SELECT {columns} FROM lab.{table}_history WHERE tick >= ? AND {condition} "
                "ORDER BY tick",
                [ticks[0]],
            )
            return [list(row) for row in found.fetchall()]

        assert rows(POSE, "entities", "name = 'ball'") == [told["ball"] for told in expected]
        assert rows("position, velocity", "joints") == [told["hinge"] for told in expected]
        forces = [[force] for told in expected for force in told["forces"]]
        assert rows("force", "contacts") == forces
        beams = rows(POSE, "links", "name = 'beam'")
        for beam, told in zip(beams, expected, strict=True):  # PyBullet rounds poses of links
            assert beam == pytest.approx(told["beam"], abs=1e-6)
        touching = ss.eval(
            "SELECT tick FROM lab{} WHERE touching(this, lab.floor) AND id != 'arm' AS list;"
        )
        assert touching == [told["tick"] for told in expected if told["touching"]]
        angles = [told["hinge"][0] for told in expected]
        assert ss.eval("joint(lab.arm, 'hinge');") == angles[-1]
        ss.add_variable("T", 0.025)
        assert ss.eval("SELECT z FROM lab{T} WHERE id == 'ball' AS value;") in [
            told["ball"][2] for told in expected
        ]
        assert ss.eval("joint(lab{T}.arm, 'hinge');") in angles[1:-1]
        mass = ss.eval("SELECT mass FROM lab WHERE id == 'arm' AS value;")
        assert mass == 0.5  # of the beam: PyBullet takes a fixed base to have none
