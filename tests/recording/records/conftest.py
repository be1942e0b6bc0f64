"""Fixtures of the tests in this folder."""

import pytest

import ssduck
from ssduck.schema import RECORDABLE
from tests.support.recorded import (
    ALL,
    MODELS,
    PAST,
    PRESENT,
    PROGRAMS,
    answer,
    end_part,
    live_lab,
    rows,
    sphere,
)

pybullet = pytest.importorskip("pybullet")


@pytest.fixture(scope="module")
def kitchen(tmp_path_factory):
    """The kitchen live, from a folder, written live to a folder, and from a DuckDB file."""
    place = tmp_path_factory.mktemp("kitchen")
    recorded = place / "run.duckdb"
    ss = ssduck.load("kitchen", recorded, recording=ALL)
    with ss.record_to(place / "live") as live:
        for tick in range(25):
            if tick == 12:
                end_part(live)
                ss.flush()
            ss.call_variable("kitchen").step(4)
    ss.export(place / "folder")
    answers = {program: answer(ss, program) for program in PROGRAMS["kitchen"]}
    tables = {name: rows(ss, name) for name in (*PRESENT, *PAST, *MODELS)}
    ss.close()
    opened = {
        "folder": ssduck.open(place / "folder"),
        "live": ssduck.open(place / "live"),
        "file": ssduck.open(recorded),
    }
    yield answers, tables, opened
    for each in opened.values():
        each.close()


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """The same of a world whose bodies come and go."""
    place = tmp_path_factory.mktemp("lab")
    client = pybullet.connect(pybullet.DIRECT)
    ss = ssduck.Interpreter(place / "run.duckdb", recording=None)
    live_lab(ss, client)
    ss.export(place / "folder")
    ss.flush()
    answers = {program: answer(ss, program) for program in PROGRAMS["lab"]}
    tables = {name: rows(ss, name) for name in (*PRESENT, *PAST, *MODELS)}
    ss.close()
    pybullet.disconnect(client)
    opened = {"folder": ssduck.open(place / "folder"), "file": ssduck.open(place / "run.duckdb")}
    # What was opened can be written again.
    opened["folder"].export(place / "copy")
    opened["live"] = ssduck.open(place / "copy")
    yield answers, tables, opened
    for each in opened.values():
        each.close()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two episodes of one world and one of another; something unfinished lies about."""
    place = tmp_path_factory.mktemp("records") / "it's a folder, ü"
    client = pybullet.connect(pybullet.DIRECT)
    with ssduck.Interpreter(recording=None) as ss:
        live_lab(ss, client, ticks=5)
        ss.export(place)
        ss.call_variable("lab").step()
        ss.export(place)
        other = pybullet.connect(pybullet.DIRECT)
        sphere(other, [0, 0, 1])
        ss.add_variable("still", ssduck.World.attach(other))
        ss.record("still", ALL)
        ss.export(place, "still")
        pybullet.disconnect(other)
    pybullet.disconnect(client)
    for table in RECORDABLE:
        (place / table / "world=lab/episode=0/.part-000001.parquet.unfinished").write_bytes(b"PAR1")
    return place
