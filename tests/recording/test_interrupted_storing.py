"""Ctrl-C and SIGTERM while ticks are stored: each of them is stored once, in all formats."""

import math
import signal
import sys
import threading
import time
from contextlib import suppress
from functools import partial
from types import SimpleNamespace

import pybullet
import pytest

import ssduck
from ssduck.database.connection import Connection
from ssduck.recording.background_writer import BufferedRows
from ssduck.recording.recorder import BUFFERED_TICKS
from ssduck.recording.stores.duckdb import DuckDBStore
from ssduck.recording.stores.parquet import ParquetStore
from tests.support.cases import generated, sampled
from tests.support.presser import Presser
from tests.support.timing import HANGS

TICKS = 12
# How often Ctrl-C is pressed, at lines that are spread over a method.
PRESSES = generated(2)


ENTITIES = ssduck.Recording(tables=("entities",))


def recorded(ss, flush, close):
    step = partial(ss["kitchen"].step, 2, every=1)
    return SimpleNamespace(ss=ss, step=step, flush=flush, close=close)


def in_database(file):
    """The ticks of a world in a DuckDB file."""
    ss = ssduck.load("kitchen", file, recording=ENTITIES)
    return recorded(ss, ss.flush, ss.close)


def in_running_folder(folder):
    """The ticks of a world in a folder, whose recording ends with the interpreter."""
    ss = ssduck.load("kitchen", recording=None)
    return recorded(ss, ss.record_to(folder, recording=ENTITIES).flush, ss.close)


def in_folder(folder):
    """The same; the recording is closed first."""
    ss = ssduck.load("kitchen", recording=None)
    recording = ss.record_to(folder, recording=ENTITIES)
    return recorded(ss, recording.flush, lambda: (recording.close(), ss.close()))


def stored_once(path, line, form, method, number):
    """Checks what is stored if a signal comes at a line of a method; returns the number of lines."""
    one = form(path)
    one.ss["kitchen"].step(TICKS, every=1)
    with suppress(KeyboardInterrupt, SystemExit), Presser(line, number) as presser:
        getattr(one, method)()
    one.flush() if method == "flush" else None
    one.close()
    with ssduck.open(path) as ss:
        ticks = ss.sql("SELECT count(*), count(DISTINCT tick) FROM ticks_history").fetchall()
        sql = "SELECT count(*), count(DISTINCT (tick, id)), max(tick) FROM entities_history"
        rows, different, last = ss.sql(sql).fetchall()[0]
        bodies = ss.sql("SELECT count(*) FROM entities").fetchall()[0][0]
    ((count, different_ticks),) = ticks
    assert count == different_ticks
    assert count == TICKS + 1 or (method == "step" and count > TICKS)
    assert rows == different == count * bodies
    assert last == ssduck.episodes(path)[0].last_tick
    assert ssduck.episodes(path)[0].complete
    assert ssduck.check(path) == []
    return presser.count


def at_spread_lines(work, folder):
    """Does work without a signal, and with one at lines of it; it returns the number of lines."""
    count = work(folder / "whole.duckdb", math.inf)
    assert count > PRESSES
    for press in range(PRESSES):
        line = 1 + press * (count - 1) // (PRESSES - 1)
        work(folder / f"{line}.duckdb", line)


@pytest.mark.slow
@sampled("method", ["flush", "close"], every=2)
@sampled("form", [in_database, in_folder, in_running_folder], every=2)
def test_all_is_stored_once(form, method, tmp_path):
    work = partial(stored_once, form=form, method=method, number=signal.SIGINT)
    at_spread_lines(work, tmp_path)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="Windows has another SIGTERM")
@sampled("method", ["step", "flush", "close"], every=3)
@sampled("form", [in_database, in_running_folder], every=2)
def test_a_program_that_sigterm_ends_has_stored_all(form, method, tmp_path):
    """Its handler is one that exits, as many programs have; the record is closed on the way."""
    kept = signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        work = partial(stored_once, form=form, method=method, number=signal.SIGTERM)
        at_spread_lines(work, tmp_path)
    finally:
        signal.signal(signal.SIGTERM, kept)


@pytest.mark.slow
@sampled("form", [in_database, in_running_folder], every=2)
def test_close_waits_for_what_is_being_stored(form, tmp_path, monkeypatch):
    """Ctrl-C comes while a slow disk is written, and once more while it is waited for."""
    store = {in_database: DuckDBStore, in_running_folder: ParquetStore}[form]
    append = store.append
    began = threading.Event()

    def slow(*arguments):
        began.set()
        time.sleep(0.3)
        return append(*arguments)

    monkeypatch.setattr(store, "append", slow)
    one = form(tmp_path / "run.duckdb")
    one.ss["kitchen"].step(TICKS, every=1)
    began.clear()

    def press():
        for _ in range(2):
            began.wait(HANGS)
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
            time.sleep(0.1)

    presses = threading.Thread(target=press)
    presses.start()
    with pytest.raises(KeyboardInterrupt):
        one.close()
    presses.join()
    assert ssduck.episodes(tmp_path / "run.duckdb")[0].ticks == TICKS + 1
    assert ssduck.episodes(tmp_path / "run.duckdb")[0].complete


@pytest.mark.long
def test_another_recording_begins_or_the_one_goes_on(tmp_path):
    def begin(path, line):
        with ssduck.load("kitchen", path) as ss:
            ss["kitchen"].step(2, every=1)
            with suppress(KeyboardInterrupt), Presser(line) as presser:
                ss.record("kitchen", ENTITIES, tags={"new": True})
            ss["kitchen"].step(2, every=1)
            assert len(ss.past("kitchen").times) in (3, 5)
        *_, last = ssduck.episodes(path)
        assert last.complete
        assert last.ticks == (3 if last.tags else 5)
        return presser.count

    at_spread_lines(begin, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("is_folder", [False, True])
def test_another_episode_begins_or_the_one_goes_on(is_folder, tmp_path):
    def begin(path, line):
        client = pybullet.connect(pybullet.DIRECT)
        pybullet.createMultiBody(1.0, physicsClientId=client)
        world = ssduck.World.attach(client, name="lab")
        with ssduck.Interpreter(":memory:" if is_folder else path, recording=None) as ss:
            ss.add_variable("lab", world)
            if is_folder:
                ss.record_to(path)
            else:
                ss.record("lab", ENTITIES)
            world.step(2, every=1)
            with suppress(KeyboardInterrupt), Presser(line) as presser:
                world.begin_episode()
            world.step(2, every=1)
        pybullet.disconnect(client)
        episodes = ssduck.episodes(path)
        assert all(episode.complete for episode in episodes)
        assert [episode.ticks for episode in episodes] in ([5], [6], [3, 2], [3, 3])
        return presser.count

    at_spread_lines(begin, tmp_path)


@pytest.mark.slow
def test_ticks_that_are_stored_while_a_recording_begins_are_read_once(tmp_path, monkeypatch):
    """The first tick is stored in the background, at the moment at which DuckDB gets it."""
    arrow = BufferedRows.arrow.fget
    waited_for = []

    def rows_before_they_are_stored(rows):
        table = arrow(rows)
        for thread in threading.enumerate():
            if thread.name == "ssduck stores" and table.num_rows:
                thread.join(0.5)  # a query lets it wait
                waited_for.append(not thread.is_alive())
        return table

    with ssduck.load("kitchen", tmp_path / "run.duckdb") as ss:
        monkeypatch.setattr(BufferedRows, "arrow", property(rows_before_they_are_stored))
        ss.record("kitchen", ssduck.Recording(every=2))
        assert any(waited_for)
        ticks = "SELECT count(*), count(DISTINCT tick) FROM ticks_history"
        assert ss.sql(ticks).fetchall() == [(1, 1)]
        sql = "SELECT count(*), count(DISTINCT (tick, id)) FROM entities_history"
        rows, different = ss.sql(sql).fetchall()[0]
        assert rows == different > 0


@pytest.mark.long
def test_rows_that_ctrl_c_kept_from_duckdb_are_there_at_the_next_query(tmp_path, monkeypatch):
    """It is pressed while DuckDB gets tables that replace full ones."""
    register = Connection.register

    def pressed(connection, name, rows):
        monkeypatch.undo()
        register(connection, name, rows)
        raise KeyboardInterrupt

    def counts():
        tables = "ticks_history", "entities_history"
        return [ss.sql(f"SELECT count(DISTINCT tick) FROM {t}").fetchall()[0][0] for t in tables]

    with ssduck.load("kitchen", tmp_path / "run.duckdb") as ss:
        assert counts() == [1, 1]
        ss["kitchen"].step(BUFFERED_TICKS + 2, every=1)
        monkeypatch.setattr(Connection, "register", pressed)
        with pytest.raises(KeyboardInterrupt):
            counts()
        ss["kitchen"].step(3, every=1)
        assert counts() == [BUFFERED_TICKS + 6] * 2
