"""A record that is removed or replaced while it is open, and files without permission."""

import os
import re
import shutil
from contextlib import contextmanager

import pytest

import ssduck
from ssduck.errors import RecordError, SqlError
from ssduck.limits import Limits
from ssduck.recording.opened_record import OpenedRecord
from ssduck.recording.stores.parquet_layout import FolderRun
from tests.support.cases import sampled
from tests.support.recorded import nobody

QUESTION = "SELECT count(*) FROM kitchen{} AS value;"
ROWS = "SELECT count(*) FROM kitchen.entities_history"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A folder with a recording of two ticks, and one with three."""
    folder = tmp_path_factory.mktemp("recorded")
    with ssduck.load("kitchen") as ss:
        ss["kitchen"].step()
        ss.export(folder / "two")
        ss["kitchen"].step()
        ss.export(folder / "three")
    return folder


@pytest.fixture
def run(recorded, tmp_path):
    """A record in a folder that every user may look into."""
    run = shutil.copytree(recorded / "two", tmp_path / "lake" / "run")
    len(ssduck.lake(recorded))  # imports what another user may not read
    closed = [p for p in run.parents if p.stat().st_uid == os.getuid() and not p.stat().st_mode & 1]
    for parent in closed:  # they stay open: tests in other processes need them, too
        parent.chmod(0o711)
    return run


def ask(ss):
    """Asks all doors to the past; returns the errors."""
    errors = []
    for question in (
        lambda: ss.eval(QUESTION),
        lambda: ss.eval("SELECT max(z(this)) FROM kitchen{} AS value;"),
        lambda: ss.sql(ROWS).fetchall(),
    ):
        with pytest.raises(RecordError) as caught:
            question()
        errors.append(str(caught.value))
    return errors


@pytest.mark.slow
@pytest.mark.parametrize("is_asked", [False, True])
@pytest.mark.parametrize(
    ("other", "told"),
    [
        ("three", "another recording than when it was opened"),
        (None, "was removed after it was opened"),
    ],
)
def test_a_record_that_is_replaced_or_removed(run, recorded, is_asked, other, told):
    with ssduck.open(run) as ss:
        if is_asked:
            ss.eval(QUESTION)
            ss.sql(ROWS).fetchall()
        shutil.rmtree(run)
        if other is not None:
            shutil.copytree(recorded / other, run)
        errors = ask(ss)
        assert all(str(run) in error for error in errors)
        if is_asked:  # otherwise a checksum may be wrong, or a part be missed, first
            assert all(told in error for error in errors)
    if other is not None:
        with ssduck.open(run) as ss:
            assert ss.eval("SELECT count(*) FROM kitchen AS value;") > 0


def test_a_record_that_is_replaced_while_it_is_opened(run, recorded):
    """Its description was read before."""
    described = FolderRun(run, "kitchen", 0)
    assert described.description["id"]
    shutil.rmtree(run)
    shutil.copytree(recorded / "three", run)
    opened = OpenedRecord(run, described.about_file, described.description, described.about_status)
    with pytest.raises(RecordError, match="another recording than when it was opened"):
        opened.check()


# What SQL reads of the parts of a record.
OF_PARTS = [
    "SELECT sum(z) FROM kitchen.entities_history",
    "SELECT max(z) FROM kitchen.entities_history WHERE tick > ?",
    "SELECT count(DISTINCT name) FROM kitchen.entities_model",
]


def ask_of_parts(ss):
    for sql in OF_PARTS:
        with pytest.raises(RecordError) as caught:
            ss.sql(sql, [0] if "?" in sql else None).fetchall()
        yield str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("is_strict", [False, True])
@pytest.mark.parametrize("name", ["run", "a [run]"])
@pytest.mark.parametrize("is_asked", [False, True])
def test_a_part_that_is_removed(run, is_asked, name, is_strict):
    run = run.rename(run.with_name(name))
    parts = [next((run / table).rglob("*.parquet")) for table in ("entities", "models/entities")]
    with ssduck.open(run, limits=Limits.strict(require=()) if is_strict else None) as ss:
        for sql in OF_PARTS if is_asked else ():
            ss.sql(sql, [0] if "?" in sql else None).fetchall()
        for part in parts:
            part.unlink()
        for error, part in zip(ask_of_parts(ss), [parts[0], *parts], strict=True):
            assert error.startswith(f"{part} ")
        with pytest.raises(SqlError, match="No files found"):  # of another folder
            ssduck.Interpreter().sql("FROM 'none.parquet'")


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has other permissions")
@sampled("place", ["", "entities", "models", "part"], every=2)
@pytest.mark.parametrize("is_asked", [False, True])
def test_a_part_that_may_no_longer_be_read(run, place, is_asked):
    closed = next((run / "entities").rglob("*.parquet")) if place == "part" else run / place
    for path in (run, *run.rglob("*")):
        path.chmod(0o755)
    sql = OF_PARTS[2 if place == "models" else 0]
    with ssduck.open(run) as ss:
        ss.sql(sql).fetchall() if is_asked else None
        told = f"{run}.*: Permission denied$"
        with denied(closed), pytest.raises(RecordError, match=told) as caught:
            ss.sql(sql).fetchall()
        assert isinstance(caught.value, PermissionError)


@pytest.mark.slow
def test_tags_of_an_open_record(run):
    with ssduck.open(run) as ss:
        before = ss.eval(QUESTION)
        ssduck.lake(run).set_tags({"checked": True})
        assert ss.eval(QUESTION) == before


@contextmanager
def denied(place, mode=0o000):
    """A file or folder has a mode for another user than root, who may read everything."""
    before = place.stat().st_mode
    place.chmod(mode)
    try:
        with nobody():
            yield
    finally:
        place.chmod(before)


DOORS = {
    "open": ssduck.open,
    "open partial": lambda run: ssduck.open(run, partial=True),
    "episodes": ssduck.episodes,
    "check": ssduck.check,
    "write": lambda run: ssduck.write_record(run, ["cup"], {"cup": [0, 0, 1]}, [0.0]),
    "import": lambda run: ssduck.import_poses(run, run.parent / "imported", world="kitchen"),
}


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has other permissions")
@sampled("mode", [0o000, 0o644], ids=oct, every=2)
@pytest.mark.parametrize("door", DOORS)
def test_a_folder_without_permission(door, mode, run):
    ssduck.open(run).close()  # imports what it needs
    told = f"{run.parent}.*Permission denied"
    with denied(run, mode), pytest.raises(RecordError, match=told):
        DOORS[door](run)


@pytest.mark.skipif(os.name == "nt", reason="Windows has other permissions")
@pytest.mark.parametrize("table", ["episodes", "ticks", "entities", "models"])
def test_a_part_without_permission(table, run):
    ssduck.open(run).close()
    with denied(run / table), pytest.raises(RecordError, match="Permission denied"):
        ssduck.open(run)


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has other permissions")
@sampled(
    ("place", "pattern"),
    [("entities", "*.parquet"), ("ticks", "*.parquet"), ("models", "*.parquet"), ("episodes", "*")],
    every=2,
)
def test_a_file_without_permission_is_not_damaged(run, place, pattern):
    """A repair would drop it."""
    assert ssduck.check(run, repair=True) == []
    with ssduck.open(run, partial=True) as ss:
        ss.eval(QUESTION)
    part = next((run / place).rglob(pattern))
    for path in (run, *run.rglob("*")):
        path.chmod(0o777)
    with denied(part):
        for door in (
            lambda: ssduck.open(run).eval(QUESTION),
            lambda: ssduck.open(run, partial=True).eval(QUESTION),
            lambda: ssduck.check(run),
            lambda: ssduck.check(run, repair=True),
        ):
            with pytest.raises(RecordError, match=f"{part} cannot be read: Permission denied$"):
                door()
    assert ssduck.check(run) == []


@pytest.mark.skipif(os.name == "nt", reason="Windows has other permissions")
def test_a_lake_names_the_folders_that_it_leaves_out(run):
    other = shutil.copytree(run, run.parent / "other" / "run").parent
    run.parent.chmod(0o755)
    with denied(other), pytest.warns(UserWarning, match=f"records in {other} are left out"):
        assert len(ssduck.lake(run.parent)) == 1
    assert len(ssduck.lake(run.parent)) == 2


@pytest.mark.skipif(os.name == "nt", reason="Windows has other permissions")
def test_a_lake_without_permission(run):
    told = f"{run.parent}: Permission denied"
    with denied(run.parent, 0o711), pytest.raises(RecordError, match=told):
        ssduck.lake(run.parent)
    run.parent.chmod(0o755)
    with denied(run, 0o644):
        assert "Permission denied" in ssduck.lake(run.parent).episodes["error"][0].as_py()


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has other permissions")
@pytest.mark.parametrize("place", ["entities", "ticks", "episodes"])
@pytest.mark.parametrize("is_listed", [False, True])
def test_questions_to_a_lake_without_permission(run, place, is_listed):
    """It was listed before, or not."""
    closed, program = run / place, "max(z(kitchen.can));"
    lake = ssduck.lake(run.parent) if is_listed else None
    lake and lake.ask(program, processes=1)
    for path in (run.parent, run, *run.rglob("*")):
        path.chmod(0o777)
    told = f"{closed}.*: Permission denied"
    with denied(closed):
        lake = lake or ssduck.lake(run.parent)
        (error,) = lake.ask(program, processes=1)["error"].to_pylist()
        assert re.fullmatch(told, error)
        if not is_listed:
            with pytest.raises(ssduck.errors.ArgumentError, match=f"no episode.*{told}"):
                lake.sql(program)
            with pytest.warns(UserWarning, match=f"episodes without tags: 1 .*{told}; "):
                assert lake.set_tags({"seen": True}) == 0
        else:
            with pytest.raises(ssduck.errors.SelectScriptError, match="Permission") as caught:
                lake.sql(program)
            assert str(closed) in str(caught.value)
