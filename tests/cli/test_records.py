"""`ssduck record`, `export` and queries of records."""

import json
import re
import signal
import time
from pathlib import Path

import pytest

import ssduck
from tests.support.cases import sampled
from tests.support.command_line import LINUX, answer, fails, ssduck_, start, written
from tests.support.timing import HANGS

pytestmark = pytest.mark.slow


@sampled("output", ["run", "run.duckdb"], every=2)
def test_a_scene_is_recorded_and_asked(here, output):
    written = answer("record", "two.toml", "--seconds", "0.5", "-o", output)
    assert written == f"51 ticks of 'two', from 0 s to 0.5 s: episode 0 in {output}\n"
    few = ["--tables", "entities", "--entities", "small", "--every", "5"]
    written = answer("record", "two.toml", "--seconds", "0.1", "--output", output, *few)
    assert written == f"3 ticks of 'two', from 0 s to 0.1 s: episode 1 in {output}\n"
    for episode, ids in ((0, ["big", "small"]), (1, ["small"])):
        asked = ["query", output, "SELECT id FROM two{0.0} AS list;", "-F", "json"]
        assert json.loads(answer(*asked, "--episode", str(episode))) == ids
    assert json.loads(answer(*asked)) == ["small"]
    assert json.loads(answer("query", output, "getTime();", "-F", "json")) == pytest.approx(0.1)
    sql = "SELECT count(*) AS n FROM entities_history"
    assert answer("query", output, "--sql", sql, "--episode", "0", "-F", "csv") == "n\n102\n"
    lines = answer("episodes", output).splitlines()
    assert lines[0].split() == ["world", "episode", "started", "ticks", "from", "to", "tables"]
    every = "contacts entities joints links sensings shapes"
    assert re.fullmatch(rf"two +0  \S+ +51 +0  0.5  {every}", lines[2])
    assert re.fullmatch(r"two +1  \S+ +3 +0  0.1  entities", lines[3])


def test_a_record_of_one_tick(here):
    written = answer("record", "two.toml", "--seconds", "0", "-o", "run")
    assert written == "1 tick of 'two', at 0 s: episode 0 in run\n"


def test_a_record_is_exported(here):
    answer("record", "two.toml", "--seconds", "0.5", "-o", "run.duckdb")
    written = answer("export", "run.duckdb", "-o", "all")
    assert written == "two: all/ticks/world=two/episode=0\n"
    some = ["--entities", "big", "--start", "0.1", "--end", "0.2"]
    answer("export", "all", "--output", "some", "--world", "two", "--episode", "0", *some)
    (episode,) = ssduck.episodes("some")
    assert (episode.ticks, episode.start, episode.entities) == (11, 0.1, ("big",))
    assert ssduck.episodes("all")[0].ticks == 51


RECORD_ERRORS = [
    (["query", "nothing.duckdb", "1;"], 1, "there is no scene 'nothing.duckdb'"),
    (["query", "empty", "1;"], 1, "empty is no record of ssduck: it has no ssduck.json"),
    (["query", "run", "SELECT z FROM tow;"], 1, "did you mean 'two'"),
    (["query", "run", "1;", "--steps", "5"], 2, "a record cannot be simulated further"),
    (["query", "run", "1;", "--episode", "3"], 1, "no episode 3 has ticks"),
    (["query", "two.toml", "1;", "--episode", "3"], 2, "two.toml is no record"),
    (["view", "two.toml", "--episode", "1", "--no-browser"], 2, "two.toml is no record"),
    (["episodes", "nothing"], 1, "there is no record nothing: neither a folder nor a DuckDB file"),
    (["episodes", "two.toml"], 1, "two.toml cannot be opened"),
    (["export", "run", "-o", "empty/../run/ssduck.json"], 1, "is a file, and a record"),
    (["export", "run", "-o", "out", "--entities", "bigg"], 1, "did you mean 'big'?"),
    (["export", "run", "-o", "out", "--world", "too"], 1, "did you mean 'two'?"),
    (["export", "run", "-o", "out", "--start", "9"], 1, "no tick of 'two' of that time"),
    (["record", "two.toml", "-o", "out"], 2, "--seconds"),
    (["record", "two.toml", "--seconds", "1"], 2, "--output"),
    (["record", "two.toml", "--seconds", "1", "-o", "out", "--tables", "entitis"], 1, "'entities'"),
    (["record", "two.toml", "--seconds", "1", "-o", "out", "--entities", "bg"], 1, "'big'?"),
    (["record", "two.toml", "--seconds", "1", "-o", "."], 1, "has something else in it"),
    (["record", "two.toml", "--seconds", "1", "-o", "box.urdf"], 1, "box.urdf is a file, and a"),
    (["export", "run", "-o", "box.urdf/run"], 1, "box.urdf/run cannot be written: Not a directory"),
]


@sampled(
    ("arguments", "code", "told"),
    RECORD_ERRORS,
    every=5,
    ids=[" ".join(a)[:60] for a, _, _ in RECORD_ERRORS],
)
def test_errors_of_records(here, arguments, code, told):
    (here / "empty").mkdir()
    answer("record", "two.toml", "--seconds", "0.02", "-o", "run")
    assert fails(arguments, code, told).stdout == ""
    assert not Path("out").exists()


def test_a_folder_of_the_name_of_a_scene_is_not_taken_for_it(here):
    answer("record", "two.toml", "--seconds", "0.02", "-o", "kitchen")
    assert answer("query", "kitchen", "count(SELECT this FROM kitchen AS list);") == "37\n"
    assert answer("query", "./kitchen", "count(SELECT this FROM two AS list);") == "2\n"


ENDS = [
    (signal.SIGINT, "interrupted: the record is complete up to then\n"),
    (signal.SIGTERM, "terminated: the record is complete up to then\n"),
]


@LINUX
@sampled(
    ("output", "number", "told"),
    [(output, *end) for output in ("run", "run.duckdb") for end in ENDS],
    every=4,
)
def test_an_interrupted_recording_is_whole(here, output, number, told):
    recording = ["two.toml", "--seconds", "100000", "-o", output, "--flush-every", "1000"]
    with start("record", *recording) as process:
        began = time.monotonic()
        while time.monotonic() < began + HANGS and written(here, output) < 200_000:
            time.sleep(0.05)
        process.send_signal(number)
        out, err = process.communicate(timeout=HANGS)
    assert (process.returncode, err) == (128 + number, told)
    (episode,) = ssduck.episodes(output)
    assert out.startswith(f"{episode.ticks} ticks of 'two', from 0 s to {episode.end:g} s")
    assert episode.ticks > 10


def test_a_bar_on_a_terminal(here):
    terminal = {"FORCE_COLOR": "1", "COLUMNS": "60", "TERM": "xterm"}
    result = ssduck_("record", "two.toml", "--seconds", "0.2", "-o", "run", env=terminal)
    assert "Recording two" in result.stderr
    assert "Recording" not in result.stdout
