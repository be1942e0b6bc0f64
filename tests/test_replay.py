"""A record answers as the live world did, tick by tick, and its triggers fire as they did."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import ssduck
from ssduck.errors import EvaluationError, UnsupportedError
from tools import replay


def test_a_record_answers_as_the_live_world_did(tmp_path: Path) -> None:
    live = replay.recorded(tmp_path / "run", 0.8, 12, seed=3)
    again = replay.replayed(tmp_path / "run", list(live.answers))
    assert len(live.answers) == 16
    assert all(any(answer != "[]" for answer in told) for told in live.answers.values())
    assert replay.differences(live, again) == []


def test_what_differs_is_found() -> None:
    live = replay.Told({1.0: ["[1]", "[2]"], 2.0: ["[]"]}, [(1.0, "[]")])
    again = replay.Told({1.0: ["[1]", "[3]"]}, [])
    assert len(replay.differences(live, again)) == 3


@pytest.fixture
def opened(tmp_path: Path) -> Any:
    """A second of the kitchen, a tick each 24 steps, and the record of it, opened."""
    with ssduck.load("kitchen") as ss:
        kitchen = ss.call_variable("kitchen")
        with ss.record_to(tmp_path / "run"):
            for _ in range(10):
                kitchen.step(24)
    with ssduck.open(tmp_path / "run") as record:
        yield record, record.call_variable("kitchen")


def test_a_record_is_gone_through(opened: Any) -> None:
    ss, kitchen = opened
    assert kitchen.time == pytest.approx(1.0)
    assert kitchen.timestep == pytest.approx(0.1)
    assert kitchen.seek(0.55).time == pytest.approx(0.5)
    kitchen.step(2)
    assert kitchen.time == pytest.approx(0.7)
    kitchen.run(0.2)
    assert kitchen.time == pytest.approx(0.9)
    assert ss.eval("getTime();") == pytest.approx(0.9)
    assert ss.past("kitchen", -0.25).times == pytest.approx([0.7, 0.8, 0.9])
    assert ss.eval("SELECT time(this) FROM kitchen{} WHERE id(this) == 'table' AS list;")[-1] < 0.95
    with pytest.raises(EvaluationError, match="what is recorded of 'kitchen' ends at 1 s"):
        kitchen.step(2)
    assert kitchen.time == pytest.approx(0.9)
    with pytest.raises(UnsupportedError, match="a recorded tick does not change"):
        kitchen["table"].move([0, 0, 0])


def test_a_query_holds_the_record_at_its_tick(opened: Any) -> None:
    ss, kitchen = opened
    ss.add_function("goes_on", lambda _: kitchen.seek(0.0) is not None, "")
    with pytest.raises(ssduck.SelectScriptError, match="a query on 'kitchen' is running"):
        ss.eval("SELECT goes_on(this) FROM kitchen;")
    assert kitchen.time == pytest.approx(1.0)
