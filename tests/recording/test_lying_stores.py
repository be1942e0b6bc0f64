"""Object stores that refuse, fail, or lie: whatever they say is an error of a record."""

import numpy as np
import pytest

import ssduck
from ssduck.errors import RecordError
from tests.support.cases import sampled
from tests.support.lying_store import lying_store

pytest.importorskip("fsspec", reason="the extra s3 is not installed")

RUN, LAKE = "s3://lake/run", "s3://lake"
TICKS = "ticks/world=lab/episode=0/part-000000.parquet"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("bucket")
    poses = np.arange(12.0).reshape(4, 1, 3)
    ssduck.write_record(place / "run", ["cup"], poses, [0, 1, 2, 3], world="lab")
    return place


@pytest.fixture
def store(folder):
    with lying_store(folder) as lying:
        yield lying


def opened(path):
    with ssduck.open(path) as ss:
        return ss.sql("SELECT tick, x FROM entities_history ORDER BY tick").fetchall()


def in_lake(path):
    del path
    lake = ssduck.lake(LAKE)
    errors = lake.ask("SELECT x FROM lab{} AS list;", processes=1)["error"]
    return errors.to_pylist()  # type: ignore[union-attr]


ASKING = [opened, ssduck.episodes, ssduck.check]


@pytest.mark.slow
def test_what_is_right_is_read(store):
    assert opened(RUN) == [(1, 0.0), (2, 3.0), (3, 6.0), (4, 9.0)]
    assert ssduck.episodes(RUN)[0].ticks == 4
    assert ssduck.check(RUN) == []
    assert in_lake(RUN) == [None]


def messages(ask):
    """The error of a question, or the damages that it returns."""
    try:
        found = ask(RUN)
    except RecordError as error:
        return error.message
    assert ask in (ssduck.check, in_lake)
    return "".join(f"{one.file} {one.problem}" if hasattr(one, "file") else one for one in found)


@pytest.mark.slow
@sampled(
    ("ask", "status", "name"),
    [
        *((ask, 403, name) for ask in (*ASKING, in_lake) for name in (".json", ".parquet")),
        (opened, 500, ".json"),  # it is asked for again, after a pause
        (opened, 500, ".parquet"),
    ],
    every=6,
)
def test_a_refusal_names_the_object_and_what_to_do(store, ask, status, name):
    store.statuses = {name: status}
    message = messages(ask)
    assert message.startswith("s3://lake/run/")
    assert "the store says: " in message
    assert "check the address, the credentials" in message
    assert "None" not in message


@pytest.mark.slow
@sampled("ask", [opened, in_lake], every=2)
def test_half_a_body_is_an_error(store, ask):
    store.cut = (".parquet",)
    message = messages(ask)
    assert "cannot be read: the store says: " in message
    assert "None" not in message


@pytest.mark.pairwise
@pytest.mark.slow
@pytest.mark.parametrize("ask", ASKING)
@pytest.mark.parametrize(
    "name",
    [
        "episodes/lab-1.json",
        "episodes/%2e%2e-0.json",
        "log/world=lab/episode=0/part-000001-0000.arrow",
    ],
)
def test_what_is_listed_and_not_there_is_missing(store, ask, name):
    store.listed = {f"run/{name}": 10}
    if "log" in name or ask is not opened:
        assert messages(ask).startswith(f"s3://lake/run/{name} ")
    else:  # it has no ticks
        assert len(opened(RUN)) == 4
    assert len(store.requests) < 300


@pytest.mark.long
def test_a_part_that_is_gone_is_missing(store):
    store.statuses = {TICKS: 404}
    for ask in (opened, ssduck.check, in_lake):
        message = messages(ask)
        assert f"{TICKS} is missing" in message


@pytest.mark.slow
def test_episodes_without_rows_are_not_asked_for(store):
    opened(RUN)
    right = len(store.requests)
    store.listed = {f"run/episodes/lab-{number}.json": 10 for number in range(1, 500)}
    store.requests.clear()
    assert len(opened(RUN)) == 4
    assert len(store.requests) == right
    with pytest.raises(RecordError, match="no episode 700 has ticks; episodes with ticks: 0 of"):
        ssduck.open(RUN, episode=700)
    assert not any("lab-4" in path for _, path in store.requests)
