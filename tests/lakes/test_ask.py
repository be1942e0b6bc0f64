"""A lake gives the answers that each episode gives by itself."""

import math
import multiprocessing
import os
import re
import signal
from concurrent.futures import ThreadPoolExecutor

import pandas as pd
import pyarrow as pa
import pytest

import ssduck
from ssduck.errors import ArgumentError, EvaluationError, ParseError, SelectScriptError
from ssduck.lakes import engines
from ssduck.lakes.answers import AnsweredEpisode, answer_table
from ssduck.lakes.engines import answer_locally
from ssduck.lakes.manifest import EpisodeEntry
from ssduck.lakes.pool import pools
from ssduck.lakes.questions import ProgramQuestion, plain
from ssduck.lakes.workers import answer_episodes, forget_readers
from tests.lakes.conftest import EPISODES
from tests.support.cases import sampled
from tests.support.command_line import write_scene
from tests.support.lake_episodes import REWARD, SUCCESS
from tests.support.lake_questions import FURTHER, PROGRAMS, scores, whole_answer_of

pytestmark = pytest.mark.filterwarnings("ignore::ssduck.errors.ProgramWarning")


@pytest.fixture(scope="module")
def opened(recorded):
    """Each episode by itself."""
    records = [ssduck.open(recorded, "sim", number) for number in range(EPISODES)]
    yield records
    for record in records:
        record.close()


@pytest.mark.slow
@sampled("program", [*PROGRAMS.values(), *FURTHER.values()], ids=str, every=2)
def test_one_answer_for_each_episode(recorded, opened, program):
    entries = ssduck.lake(recorded)._entries
    ((_, answers),) = answer_locally(ProgramQuestion(program), [entries], 1)
    assert answers == [whole_answer_of(record, program) for record in opened]
    is_error = program in (FURTHER["error"], FURTHER["no value"])
    assert any(answer.text is not None for answer in answers) != is_error


@pytest.mark.slow
@pytest.mark.parametrize(
    ("program", "told"),
    [
        ("x(sim.cup) > goal;", "goal is a variable of the environment"),
        ("holds(x(sim.cup) > goal);", "lake.score has it in its terms"),
        ("seed;", "seed is a column of lake.episodes"),
        ("SELECT id, success FROM sim;", "success is a column of lake.episodes"),
        ("SELECT id FROM sim WHERE episode = 1;", "chooses by it: where='episode = …'"),
        ("sim;", "the answer is the world sim: ask for its entities"),
    ],
)
def test_names_of_episodes_are_told_of(recorded, program, told):
    lake = ssduck.lake(recorded)
    errors = lake.ask(program, where="episode < 2", processes=1)["error"].to_pylist()
    assert len(errors) == 2
    assert all(told in error for error in errors)
    assert all("did you mean" not in error for error in errors)
    if program != "sim;":
        with pytest.raises(SelectScriptError, match=re.escape(told)):
            lake.sql(program)


def test_other_unknown_names_have_no_such_hint(recorded):
    (error,) = ssduck.lake(recorded).ask("goals;", where="episode = 0")["error"].to_pylist()
    assert "environment" not in error
    assert "episodes" not in error


@pytest.mark.slow
def test_scores(recorded):
    rows = ssduck.lake(recorded).score(SUCCESS, reward=REWARD, processes=1).to_pylist()
    assert [(row["return"], row["success"]) for row in rows] == scores(recorded)
    assert [row["error"] for row in rows] == [None] * EPISODES
    assert rows[0]["seed"] == 0


def children():
    return {process.pid for process in multiprocessing.active_children()}


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="SIGKILL")
def test_processes_are_kept_until_one_is_killed(recorded):
    forget_readers()
    lake, others = ssduck.lake(recorded), children()
    program = PROGRAMS["last tick"]
    whole = lake.ask(program, processes=1)
    assert lake.ask(program, batch=1, processes=2).equals(whole)
    first = children() - others
    assert len(first) == 2
    assert lake.ask(program, batch=1, processes=2).equals(whole)
    assert children() - others == first
    os.kill(min(first), signal.SIGKILL)
    assert lake.ask(program, batch=1, processes=2).equals(whole)
    second = children() - others
    assert 0 < len(second) <= 2  # a process starts when the others have work
    assert not first & second
    forget_readers()
    assert children() == others


def test_answers_that_cannot_be_kept_are_told_of(recorded, tmp_path):
    entries = ssduck.lake(recorded)._entries
    with pytest.raises(EvaluationError, match=r"cannot be kept in .*: No such file"):
        engines._write_answers(ProgramQuestion("1;"), entries, tmp_path / "gone")


@pytest.mark.parametrize(("episodes", "kept", "expected"), [
    (0, None, 1), (279, None, 1), (280, None, 2), (559, None, 3), (560, None, 4), (9999, None, 4),
    (49, 2, 1), (50, 2, 2), (560, 2, 4), (200, 5, 1),
])  # fmt: skip
def test_processes_are_as_many_as_gain(monkeypatch, episodes, kept, expected):
    monkeypatch.setattr("os.cpu_count", lambda: 4)
    forget_readers()
    if kept is not None:
        pool, is_warm = pools.take(kept)  # it starts none before its first task
        assert not is_warm
        pools.keep(pool, kept)
    assert pools.default_count(episodes) == expected
    monkeypatch.setenv("SSDUCK_TEST", "the kept processes were started without it")
    assert pools.default_count(episodes) == (expected if kept is None else max(1, episodes // 140))
    forget_readers()


@pytest.mark.slow
def test_kept_answers_are_of_episodes_whatever_batches_they_were_in(
    recorded, tmp_path, monkeypatch
):
    lake, program, kept = ssduck.lake(recorded), PROGRAMS["last tick"], tmp_path / "kept"
    asked = []
    monkeypatch.setattr(
        "ssduck.lakes.engines.answer_episodes",
        lambda question, entries: asked.extend(entries) or answer_episodes(question, entries),
    )
    whole = lake.ask(program, processes=1)
    asked.clear()
    lake.ask(program, "episode IN (1, 3)", processes=1, batch=1, resume=kept)
    assert lake.ask(program, processes=1, batch=2, resume=kept).equals(whole)
    assert [entry.episode for entry in asked] == [1, 3, 0, 2, *range(4, EPISODES)]
    (damaged, *_) = kept.iterdir()
    damaged.write_bytes(damaged.read_bytes()[:-9])
    lake.ask("1;", processes=1, resume=kept)  # another question
    assert lake.ask(program, processes=1, resume=kept).equals(whole)


@pytest.mark.slow
def test_kept_answers_are_of_the_same_episodes(tmp_path):
    file, program = tmp_path / "lab.duckdb", "SELECT id FROM two{} AS list;"
    scene = write_scene(tmp_path) / "two.toml"
    for duration in (0.02, 0.03):
        file.unlink(missing_ok=True)
        with ssduck.load(scene, database=file) as ss:
            ss.run(duration)
        lake = ssduck.lake(file)
        kept = lake.ask(program, processes=1, resume=tmp_path / "kept")
        assert kept.equals(lake.ask(program, processes=1))


@pytest.mark.slow
def test_threads_ask_one_after_the_other(recorded):
    lake = ssduck.lake(recorded)
    expected = {text: lake.ask(text, processes=1) for text in PROGRAMS.values()}
    with ThreadPoolExecutor(len(expected)) as pool:
        asked = [(t, pool.submit(lake.ask, t, processes=1)) for t in expected for _ in range(4)]
        for text, answers in asked:
            assert answers.result().equals(expected[text]), text


# (condition, what is said of it)
EMPTY = [
    ("episode > 99", "of 5 episodes, 'episode > 99' holds for none$"),
    ("episode = 99", "holds for none; none has the episode 99$"),
    ("world = 'smi'", "none has the world 'smi'; did you mean 'sim'\\?$"),
    ("'smi' = world OR world IN ('sum', 'x')", "'smi'; did.*'sum'; did.*; none has the world 'x'$"),
    ("world = 'sim' AND ticks = 1.5", "holds for none$"),
]


@pytest.mark.parametrize(("where", "message"), EMPTY)
def test_a_condition_that_holds_for_no_episode_is_told(recorded, where, message):
    lake = ssduck.lake(recorded)
    with pytest.warns(UserWarning, match=message) as told:
        assert lake.ask("1;", where=where).num_rows == 0
    assert [warning.filename for warning in told] == [__file__]
    with pytest.warns(UserWarning, match=message):
        assert lake.set_tags({"seen": True}, where) == 0


def test_mistakes_are_errors_at_once(recorded):
    lake = ssduck.lake(recorded)
    for ask in (lake.ask, lake.stream):  # a stream tells of them before its first table
        with pytest.raises(ParseError):
            ask("SELECT FROM;")
        with pytest.raises(ArgumentError, match="is a text of SelectScript, not 5"):
            ask(5)
        with pytest.raises(ArgumentError, match="there is no engine 'dusk'"):
            ask("1;", engine="dusk")
        with pytest.raises(ArgumentError, match="batch"):
            ask("1;", batch=0)
        with pytest.raises(ArgumentError, match="where"):
            ask("1;", where="SELECT")
    with pytest.raises(
        ArgumentError, match=r"tag takes a program \(set_tags takes tags\), not {'a'"
    ):
        lake.tag("task", {"a": 1})
    with pytest.raises(ArgumentError, match=r"is a text of SelectScript, not {'a': 1}"):
        lake.sql({"a": 1})


@pytest.mark.parametrize("frame", [pd.DataFrame({"z": [1]}), pa.table({"z": [1]})])
def test_a_frame_is_told_of(frame):
    with pytest.raises(ArgumentError, match=r"leave its AS … out; ask\(…\)\.to_pandas\(\)"):
        plain(frame)


def row(text, error=None):
    return AnsweredEpisode(EpisodeEntry("/r", "w", 1), text, error)


@pytest.mark.parametrize(
    ("texts", "type", "values"),
    [
        (["1", "2.5"], pa.float64(), [1.0, 2.5]),
        (["true", "null"], pa.bool_(), [True, None]),
        (["[0.1, 2]", "[3.5, 4.5]"], pa.list_(pa.float64()), [[0.1, 2], [3.5, 4.5]]),
        (["true", "1"], pa.string(), ["true", "1"]),
        (["0.5", "true"], pa.string(), ["0.5", "true"]),
        (["[0.5]", "[true]"], pa.string(), ["[0.5]", "[true]"]),
        (['[1, "a"]', "null"], pa.string(), ['[1, "a"]', None]),
        (["Infinity", "0.1"], pa.float64(), [math.inf, 0.1]),
        ([str(2**80)], pa.string(), [str(2**80)]),
    ],
)  # fmt: skip
def test_types_of_answers(texts, type, values):
    table = answer_table(map(row, texts))
    assert table["answer"].type == type
    assert table["answer"].to_pylist() == values


def test_records_are_rows():
    rows = [row('[{"id": "a", "path": 1}, {"id": "b", "path": 2}]'), row("[]"), row(None, "no")]
    table = answer_table(rows)
    assert table.select(["id", "path_", "error"]).to_pylist() == [
        {"id": "a", "path_": 1, "error": None},
        {"id": "b", "path_": 2, "error": None},
        {"id": None, "path_": None, "error": "no"},
    ]


def test_nan_stays():
    table = answer_table([row("NaN"), row("1.0")])
    assert math.isnan(table["answer"][0].as_py())
