"""The page of the format is enough to write a record with pyarrow alone; what a DuckDB file has is plain."""

import subprocess
import sys
from pathlib import Path

import duckdb
import pyarrow.parquet as pq
import pybullet
import pytest

import ssduck
from ssduck.recording.stores.stored_columns import part_columns
from ssduck.schema import MODELS, RECORDED
from tests.support.bodies import solid

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "reference" / "record-format.md"
EXAMPLE = ROOT / "examples" / "plain_record.py"


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The record of the page's example, run where ssduck cannot be imported."""
    place = tmp_path_factory.mktemp("page")
    alone = "import sys; sys.modules['ssduck'] = None\n"
    run = f"import runpy; runpy.run_path({str(EXAMPLE)!r})"
    subprocess.run([sys.executable, "-c", alone + run], cwd=place, check=True)
    return place / "fallen"


@pytest.mark.slow
def test_the_example_opens_and_is_asked(written):
    (episode,) = ssduck.episodes(written)
    assert (episode.ticks, episode.complete, episode.tags) == (5, True, {"task": "fall"})
    assert ssduck.check(written) == []
    with ssduck.open(written) as ss:
        gaps = ss.eval("SELECT clearance(lab.floor, this) FROM lab{} WHERE id == 'ball' AS list;")
        assert gaps == pytest.approx([0.9 - 4.9 * (n / 10) ** 2 for n in range(5)], abs=1e-12)
        assert ss.eval("SELECT id FROM lab WHERE isSphere(this) AS list;") == ["ball"]
        assert ss.sql("SELECT count(*) FROM entities_history WHERE vx IS NULL").fetchone() == (10,)
        assert ss.eval("SELECT this FROM lab{} WHERE collides(this, lab.floor) AS list;") == []


def test_the_example_has_all_columns_of_its_tables(written):
    for table in ("ticks", "entities", *(f"models/{name}" for name in MODELS)):
        (file,) = (written / table).rglob("*.parquet")
        assert set(pq.read_schema(file).names) == set(part_columns(table)), table


def test_the_page_names_all_tables_and_keys():
    text = PAGE.read_text("utf-8")
    assert f"`examples/{EXAMPLE.name}`" in text
    for name in (*RECORDED, *(f"models/{name}" for name in MODELS)):
        assert name in text, name
    from ssduck.recording.stores.descriptions import EPISODE

    for key in EPISODE:
        assert f"`{key}`" in text, key


BODIES = 10
TICKS = 6


@pytest.fixture
def world(client):
    """A world of boxes."""
    for place in range(BODIES):
        solid(client, pybullet.GEOM_BOX, 1, [place, 0, 1], halfExtents=[0.1, 0.1, 0.1])
    return ssduck.World.attach(client, name="lab")


def _record(path, world):
    with ssduck.Interpreter(str(path)) as ss:
        ss.add_variable("lab", world)
        for _ in range(TICKS - 1):
            world.step()


def _format(path):
    """Returns the version of the format of a file, and the size of its blocks, bytes."""
    with duckdb.connect(str(path), read_only=True) as plain:
        ((tags,),) = plain.execute(
            "SELECT tags FROM duckdb_databases() WHERE database_name = current_database()"
        ).fetchall()
        sizes = plain.execute("SELECT block_size FROM pragma_database_size()").fetchall()
        return tags["storage_version"], sizes[0][0]


@pytest.mark.slow
def test_a_new_file_has_the_format_of_long_term_support(world, tmp_path):
    path = tmp_path / "run.duckdb"
    _record(path, world)
    version, block = _format(path)
    assert version.startswith("v1.4.0")
    assert block == 16384
    _record(path, world)
    assert _format(path) == (version, block)
    with ssduck.open(path) as ss:
        assert len(ss.past("lab").ticks) == TICKS


@pytest.mark.slow
def test_an_episode_takes_few_bytes(world, tmp_path):
    path = tmp_path / "run.duckdb"
    sizes = []
    for _ in range(5):
        _record(path, world)
        sizes.append(path.stat().st_size)
    assert (sizes[-1] - sizes[0]) / 4 < 400_000  # 1.9 MB in blocks of DuckDB's own size
    assert [episode.ticks for episode in ssduck.episodes(path)] == [TICKS] * 5


@pytest.mark.slow
def test_a_file_of_another_format_is_written_on(world, tmp_path):
    path = tmp_path / "run.duckdb"
    duckdb.connect(str(path)).execute("CREATE TABLE mine AS SELECT 7 AS seven").close()
    before = _format(path)
    assert before[1] > 16384
    _record(path, world)
    assert _format(path) == before
    with ssduck.open(path) as ss:
        assert len(ss.past("lab").ticks) == TICKS
    with duckdb.connect(str(path), read_only=True) as plain:
        assert plain.execute("FROM mine").fetchall() == [(7,)]
