"""What is recorded by default, its bound in bytes, and the calls that keep more."""

import re

import pybullet
import pytest

import ssduck
from ssduck import Recording
from ssduck.errors import EvaluationError, SqlError
from ssduck.recording.spec import with_size_limit
from tests.support.cases import sampled
from tests.support.pasts import _step


@pytest.mark.slow
@sampled("table", ["links", "joints", "shapes", "contacts", "sensings"], every=3)
def test_the_call_that_records_a_table_is_named(falling, table):
    falling.record("lab", Recording(tables=("entities",)))
    with pytest.raises(SqlError, match=f"the table of {table} of 'lab' is not recorded") as raised:
        falling.sql(f"SELECT * FROM {table}_history")
    call = re.search(r"ss\.record\(.*\)\)", str(raised.value))
    assert call is not None
    assert "nothing brings back what is past: call it before the loop" in str(raised.value)
    eval(call.group(), {"ss": falling, "ssduck": ssduck})  # noqa: S307  # the advice as it stands
    _step(falling, 100)
    assert falling.sql(f"SELECT count(*) FROM {table}_history").fetchone() != (0,) or (
        table in ("joints", "sensings")  # there are none in this world
    )


@pytest.mark.slow
def test_entities_links_and_contacts_are_recorded_by_default(falling, tmp_path):
    client = falling.call_variable("lab").simulator.client
    rows = []
    for step in range(1, 241):
        _step(falling, 1)
        points = pybullet.getContactPoints(physicsClientId=client)
        rows += [(step + 1, point[9]) for point in points if point[8] <= 0]  # the shapes meet
    kept = falling.sql("SELECT tick, force FROM contacts_history").fetchall()
    assert sorted(kept) == sorted(rows) != []
    assert falling.sql("SELECT count(*) FROM links_history").fetchall() == [(241 * 3,)]
    world = falling.call_variable("lab")
    with ssduck.Interpreter(tmp_path / "run.duckdb") as file:
        file.add_variable("lab", world)
        world.step(1)
    with ssduck.open(tmp_path / "run.duckdb") as record:
        tables = ssduck.episodes(tmp_path / "run.duckdb")[0].tables
        assert set(tables) == {"entities", "links", "contacts"}
        assert record.sql("SELECT count(*) FROM contacts_history").fetchone() != (0,)


@pytest.mark.slow
@sampled("changed", [False, True], ids=["memory", "tables"], every=2)
def test_the_size_of_what_is_kept_is_bounded(falling, changed):
    limit = 400_000
    falling.record("lab", Recording(max_bytes=limit, changed=changed))
    world, history = falling.call_variable("lab"), falling._database._worlds.bound[0].history
    assert history is not None
    assert history.recorder is not None
    for _ in range(20):
        _step(falling, 100)
        rows = [
            falling.sql(f"FROM {table}_history").arrow()
            for table in ("entities", "links", "contacts")
        ]
        buffers = [buffer.row_bytes * buffer.count for buffer in history.recorder.buffers.values()]
        if not changed:
            assert history.store.nbytes + sum(buffers) <= limit
        times = falling.past("lab").times
        assert times[-1] == world.time
        assert len(times) == len(set(rows[0]["tick"].to_pylist()))
    assert 50 < len(times) < 2000
    falling.past("lab", times[0])
    with pytest.raises(
        EvaluationError, match=r"recorded from .*ssduck.Recording\(.*max_bytes=800000\)"
    ):
        falling.past("lab", times[0] - 1 / 240)
    with pytest.raises(EvaluationError, match="max_bytes=800000"):
        falling.eval("SELECT z FROM lab{0.0} AS list;")


def test_one_tick_is_kept_however_small_the_limit_is(falling):
    falling.record("lab", Recording(max_bytes=1))
    _step(falling, 20)
    assert 1 <= len(falling.past("lab").ticks) <= 3
    assert falling.past("lab").times[-1] == falling.call_variable("lab").time


def test_a_size_limit_is_the_default_in_memory_only():
    default = Recording()
    assert with_size_limit(default, in_memory=True).max_bytes == 512 * 2**20
    assert with_size_limit(default, in_memory=False).max_bytes is None
    assert with_size_limit(Recording(seconds=600), in_memory=True).max_bytes is None
    assert with_size_limit(Recording(max_bytes=None), in_memory=True).max_bytes is None
    assert with_size_limit(Recording(max_bytes=7), in_memory=False).max_bytes == 7
