"""The format of DuckDB files: their version, and the bytes that an episode takes."""

import duckdb
import pybullet
import pytest

import ssduck

BODIES = 10
TICKS = 6


@pytest.fixture
def world(client):
    """A world of boxes."""
    box = pybullet.createCollisionShape(
        pybullet.GEOM_BOX, halfExtents=[0.1, 0.1, 0.1], physicsClientId=client
    )
    for place in range(BODIES):
        pybullet.createMultiBody(1, box, basePosition=[place, 0, 1], physicsClientId=client)
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
