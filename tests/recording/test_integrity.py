"""Damaged records give the right answers or an error; `check` finds and repairs what is damaged."""

import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pyarrow.parquet as pq
import pytest

import ssduck
from ssduck import Recording
from ssduck.errors import RecordError
from ssduck.recording.stores.descriptions import read_description
from ssduck.recording.stores.parquet import ParquetStore
from tests.support.cases import sampled
from tests.support.command_line import answer, ssduck_
from tests.support.forged import flip_bit
from tests.support.recorded import POSIX, python
from tools import flip

PLACE = "world=lab/episode=0"
COUNT = "SELECT count(*) FROM entities_history"


@pytest.fixture(scope="module")
def records(tmp_path_factory, archive):
    """The records of `tools.flip`."""
    return archive.copy(flip.write_records, tmp_path_factory.mktemp("records"))


@pytest.fixture
def run(records, tmp_path):
    """A folder of five parts, which is closed."""
    return flip.copy_of(records / "run", tmp_path)


@pytest.fixture(scope="module")
def flips(tmp_path_factory):
    run = flip.Run(tmp_path_factory.mktemp("flips"))
    yield run
    run.close()


@pytest.mark.slow
@sampled("seed", range(24), every=4)
def test_damaged_records_give_right_answers_or_errors(flips, seed):
    """The short form of `python -m tools.flip`."""
    flips.add(seed)
    assert seed not in flips.faults, flips.faults[seed]


FILES = [
    f"entities/{PLACE}/part-000002.parquet",
    f"ticks/{PLACE}/part-000001.parquet",
    f"models/entities/{PLACE}/part-000000.parquet",
    "episodes/lab-0.json",
    "ssduck.json",
]


@pytest.mark.parametrize("name", FILES)
def test_a_flipped_bit_of_any_byte_is_noticed(run, name):
    """In the data, which the footer does not tell, and in the footer."""
    whole = (run / name).read_bytes()
    for position in (0.1, 0.3, 0.5, 0.7, 0.9, 0.999):
        (run / name).write_bytes(whole)
        flip_bit(run / name, position)
        if (run / name).suffix == ".json" and whole == (run / name).read_bytes().strip():
            continue
        with pytest.raises(RecordError, match=Path(name).name), ssduck.open(run) as ss:
            ss.sql(COUNT)


def test_a_part_is_verified_when_it_is_first_read(run):
    flip_bit(run / "contacts" / PLACE / "part-000001.parquet", 0.2)
    with ssduck.open(run) as ss:
        assert ss.sql(COUNT).fetchall() != [(0,)]
        for _ in range(2):
            with pytest.raises(RecordError, match=r"contacts/.*part-000001.* checksum is wrong"):
                ss.sql("SELECT count(*) FROM contacts_history")


def test_other_tools_can_verify_pages(run):
    file = run / "entities" / PLACE / "part-000000.parquet"
    assert pq.ParquetFile(file, page_checksum_verification=True).read().num_rows
    flip_bit(file, 0.21)
    with pytest.raises(OSError, match=r"\w"):
        pq.ParquetFile(file, page_checksum_verification=True).read()


# -- check ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_whole_records_are_intact_and_say_whether_they_are_complete(records):
    for name in flip.RECORDS:
        assert ssduck.check(records / name) == []
        (episode,) = ssduck.episodes(records / name)
        assert episode.complete is not name.startswith("unfinished")


def _rows(run):
    with ssduck.open(run) as ss:
        ticks = ss.past("lab").ticks
        assert [t for (t,) in ss.sql("SELECT DISTINCT tick FROM links_history ORDER BY 1")] == ticks
    return ticks


@pytest.mark.slow
def test_a_repair_takes_out_damaged_parts_alone(run):
    before, files = _rows(run), {file.name for file in run.rglob("*")}
    size = sum(file.stat().st_size for file in run.rglob("*.parquet"))
    flip_bit(run / "links" / PLACE / "part-000001.parquet", 0.4)
    (run / "shapes" / PLACE / "part-000003.parquet").unlink()
    found = ssduck.check(run)
    assert [(d.file.parent.parent.parent.name, d.is_repaired) for d in found] == [
        ("links", False),
        ("shapes", False),
    ]
    assert ["checksum" in d.problem for d in found] == [True, False]
    with pytest.raises(RecordError):
        ssduck.open(run)
    repaired = ssduck.check(run, repair=True)
    assert all(d.is_repaired for d in repaired)
    lost = {
        tick
        for damage in repaired
        for first, *_, last in [damage.loss.removeprefix("ticks ").split()]
        for tick in range(int(first), int(last) + 1)
    }
    assert _rows(run) == [tick for tick in before if tick not in lost]
    assert len(lost) < len(before) / 2
    assert ssduck.check(run) == []
    # Nothing is deleted, and plain tools do not read what was taken out.
    assert files - {file.name.removesuffix(".damaged") for file in run.rglob("*")} == set()
    aside = sum(file.stat().st_size for file in run.rglob("*.damaged"))
    assert aside + sum(file.stat().st_size for file in run.rglob("*.parquet")) < size
    assert read_description(run / "episodes" / "lab-0.json")["removed"] == [1, 3]


@pytest.mark.slow
def test_a_record_can_be_opened_without_its_damaged_parts(run):
    before = _rows(run)
    flip_bit(run / "entities" / PLACE / "part-000000.parquet", 0.4)
    with (
        pytest.warns(UserWarning, match=r"entities/.*part-000000.*; left out: ticks"),
        ssduck.open(run, partial=True) as ss,
    ):
        assert ss.past("lab").ticks == before[-len(ss.past("lab").ticks) :] != before
    assert len(ssduck.check(run)) == 1  # it stays as it was


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ssduck.json", "episodes/lab-0.json"])
@pytest.mark.parametrize("damage", [lambda f: flip_bit(f, 0.5), Path.unlink], ids=["bit", "gone"])
def test_descriptions_are_written_anew(run, name, damage):
    before = _rows(run)
    damage(run / name)
    (found,) = ssduck.check(run, repair=True)
    assert (found.file, found.is_repaired) == (run / name, True)
    assert _rows(run) == before
    assert ssduck.check(run) == []


def test_models_cannot_be_repaired(run):
    flip_bit(run / "models" / "links" / PLACE / "part-000000.parquet", 0.3)
    (damage,) = ssduck.check(run, repair=True)
    assert (damage.is_repaired, damage.loss) == (False, "all of episode 0 of 'lab'")


@pytest.mark.slow
def test_a_damaged_log_ends_earlier(records, tmp_path):
    run = flip.copy_of(records / "unfinished", tmp_path)
    before = _rows(run)
    file = max((run / "log").rglob("*.arrow"))
    flip_bit(file, 0.6)
    with pytest.raises(RecordError, match=rf"{file.name} cannot be read"):
        ssduck.open(run)
    (damage,) = ssduck.check(run, repair=True)
    assert (damage.file, damage.is_repaired) == (file, True)
    after = _rows(run)
    assert after == before[: len(after)] != before


@pytest.mark.slow
def test_the_log_of_a_file_is_set_aside(records, tmp_path):
    file = flip.copy_of(records / "unfinished.duckdb", tmp_path)
    before = _rows(file)
    log = file.with_name(f"{file.name}.wal")
    flip_bit(log, 0.5)
    with pytest.raises(
        RecordError, match=r"unfinished\.duckdb is damaged.*`ssduck check --repair`"
    ):
        ssduck.open(file)
    (found,) = ssduck.check(file)
    assert (found.file, found.is_repaired) == (log, False)
    (found,) = ssduck.check(file, repair=True)
    assert found.is_repaired
    assert log.with_name(f"{log.name}.damaged").exists()
    after = _rows(file)
    assert after == before[: len(after)] != before


@pytest.mark.long
def test_a_damaged_block_of_a_file_is_named(records, tmp_path):
    """DuckDB has checksums of its own; at some blocks it does not open at all."""
    whole = (records / "run.duckdb").read_bytes()
    seen = set()
    for block in range(1, 40):
        file = tmp_path / "run.duckdb"
        content = bytearray(whole)
        content[min(12288 + 16384 * block + 3000, len(content) - 1)] ^= 1
        file.write_bytes(content)
        found = ssduck.check(file) if _opens(file) else []
        if found:
            seen.add(found[0].loss.split()[0])
            assert all(d.file == file and "checksum" in d.problem for d in found)
    assert seen & {"entities", "links", "shapes", "joints", "contacts"}


def _opens(file):
    try:
        ssduck.open(file).close()
    except RecordError as error:
        assert str(file) in str(error)
        return False
    return True


@pytest.mark.slow
def test_the_command(run):
    assert answer("check", str(run)) == f"{run} is intact\n"
    flip_bit(run / "ticks" / PLACE / "part-000001.parquet", 0.4)
    result = ssduck_("check", str(run))
    assert result.exit_code == 1
    assert "its checksum is wrong" in result.stdout
    assert "True" in answer("check", str(run), "--repair")
    assert answer("check", str(run)) == f"{run} is intact\n"


# -- exports and beginnings ----------------------------------------------------------------------


FORKED = """
import os, sys, ssduck
with ssduck.open(sys.argv[1]) as ss:
    ss.eval("SELECT tick FROM lab{} AS list;")
    child = os.fork()
    if not child:
        for ask in (
            lambda: ss.eval("SELECT tick FROM lab{} AS list;"),
            lambda: ss.sql("SELECT count(*) FROM entities_history"),
            lambda: ss.eval("SELECT z FROM lab{0.05} AS list;"),
        ):
            try:
                ask()
            except ssduck.SelectScriptError as error:
                print(type(error).__name__, "open it anew here" in str(error), flush=True)
        with ssduck.open(sys.argv[1]) as anew:
            print(len(anew.past("lab").ticks), flush=True)
        os._exit(0)
    os.waitpid(child, 0)
    print(ss.sql("SELECT count(DISTINCT tick) FROM ticks_history").fetchall()[0][0])
"""


@POSIX
@pytest.mark.slow
@sampled("name", ["run", "run.duckdb"], every=2)
def test_a_forked_process_opens_a_record_anew(records, name):
    *told, anew, parent = python(FORKED, records / name).splitlines()
    assert told == ["RecordError True"] * 3
    assert anew == parent


@pytest.mark.slow
def test_recorders_begin_in_one_new_folder_at_once(tmp_path):
    """The folder, its description and the numbers of episodes are made by one of them each."""
    for attempt in range(5):
        path, start = tmp_path / str(attempt), threading.Barrier(8)

        def begin(path=path, start=start):
            start.wait()
            return ParquetStore(path, "lab", Recording()).run.number

        with ThreadPoolExecutor(8) as pool:
            numbers = [future.result() for future in [pool.submit(begin) for _ in range(8)]]
        assert sorted(numbers) == list(range(8))
        assert len(ssduck.episodes(path)) == 8
        assert not [file for file in path.rglob("*") if file.name.startswith(".")]
