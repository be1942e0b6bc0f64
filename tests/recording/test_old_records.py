"""Records of earlier formats open, with the answers that PyBullet gave when they were recorded.

`python -m tools.write_records` writes such records, and those of the present format.
"""

from __future__ import annotations

import json
import tarfile
from pathlib import Path
from typing import Any

import pytest

import ssduck

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


@pytest.mark.parametrize("kind", KINDS)
def test_an_old_record_has_the_same_answers(records: Path, kind: str) -> None:
    expected: list[dict[str, Any]] = json.loads((records / "expected.json").read_text("utf-8"))
    ticks = [told["tick"] for told in expected]
    with ssduck.open(records / kind) as ss:
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
