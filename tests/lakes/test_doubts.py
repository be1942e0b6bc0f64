"""A lake warns of probable mistakes in a question as an interpreter does, once for all episodes."""

import warnings

import pytest

import ssduck
from ssduck.errors import ProgramWarning
from ssduck.lakes.lake import MAX_DOUBTS
from ssduck.lakes.workers import forget_readers
from tests.lakes.conftest import EPISODES

# What is written wrong, a program with that, and what each episode answers.
DOUBTS = {
    "kind": ("'robto'", "count(SELECT id FROM sim WHERE kind=='robto' AS list);", 0),
    "name": ("'cpu'", "count(SELECT id FROM sim WHERE id=='cpu' AS list);", 0),
    "at a tick": ("'cpu'", "count(SELECT id FROM sim{0.05} WHERE id=='cpu' AS list);", 0),
    "alone": ("'cpu'", "count(SELECT tick FROM sim WHERE id=='cpu' AS list);", 0),
    "entity": ("'cup'", "sim.cup == 'cup';", False),
}


def asked(ask, *arguments, **named):
    """Returns what a function gives, and the texts of the warnings of programs."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = ask(*arguments, **named)
    return result, [str(one.message) for one in caught if one.category is ProgramWarning]


@pytest.mark.slow
@pytest.mark.parametrize(("word", "program", "answer"), DOUBTS.values(), ids=DOUBTS)
def test_a_doubt_is_told_once_and_refused_if_strict(recorded, word, program, answer):
    lake = ssduck.lake(recorded)
    with ssduck.open(recorded, "sim", 0) as ss:
        _, (wanted,) = asked(ss.eval, program)
    assert word in wanted
    for _ in range(2):  # of the second question, too, and after a strict one
        table, (doubt,) = asked(lake.ask, program, processes=1, batch=2)
        assert table["answer"].to_pylist() == [answer] * EPISODES
        assert doubt == f"{wanted}\n  first in episode 0 of sim in {recorded}"
        table, (told,) = asked(lake.ask, program, strict=True, processes=1, batch=2)
        assert told.startswith(f"no answer: {EPISODES} episodes failed, as the column 'error' says")
        assert table["answer"].to_pylist() == [None] * EPISODES
        assert all(word in error for error in table["error"].to_pylist())


@pytest.mark.long
def test_a_doubt_of_several_processes_is_told_once(recorded):
    lake, (word, program, _) = ssduck.lake(recorded), DOUBTS["kind"]
    _, (doubt,) = asked(lake.ask, program, processes=2, batch=1)
    assert word in doubt
    assert "first in episode 0 of sim" in doubt


def test_what_is_right_is_no_doubt(recorded):
    program = "count(SELECT id FROM sim WHERE id=='cup' AS list);"
    table, doubts = asked(ssduck.lake(recorded).ask, program, processes=1)
    assert table["answer"].to_pylist() == [1] * EPISODES
    assert doubts == []


@pytest.mark.slow
def test_streams_and_tags_warn_too(folder):
    lake, (word, program, _) = ssduck.lake(folder), DOUBTS["kind"]
    tables, (doubt,) = asked(lambda: list(lake.stream(program, batch=1, processes=1)))
    assert len(tables) == EPISODES
    assert word in doubt
    _, (doubt,) = asked(lake.tag, "robots", program, processes=1)
    assert word in doubt


def test_kept_answers_keep_their_doubts(recorded, tmp_path, monkeypatch):
    lake, (_, program, _) = ssduck.lake(recorded), DOUBTS["name"]
    before = asked(lake.ask, program, processes=1, resume=tmp_path)
    monkeypatch.setattr("ssduck.lakes.engines.answer_episodes", None)
    assert asked(lake.ask, program, processes=1, resume=tmp_path) == before
    _, (doubt,) = asked(lake.ask, program, "episode >= 3", processes=1, resume=tmp_path)
    assert "first in episode 3 of sim" in doubt


@pytest.mark.slow
def test_many_doubts_are_some_warnings(recorded):
    names = ", ".join(f"'thng_{number}'" for number in range(MAX_DOUBTS + 5))
    program = f"SELECT id FROM sim WHERE id IN ({names}) AS list;"
    _, doubts = asked(ssduck.lake(recorded).ask, program, processes=1)
    assert len(doubts) == MAX_DOUBTS + 1
    assert "left out" in doubts[-1]


@pytest.mark.slow
def test_an_interpreter_still_warns(recorded):
    forget_readers()
    _, program, _ = DOUBTS["kind"]
    asked(ssduck.lake(recorded).ask, program, processes=1)
    with ssduck.open(recorded, "sim", 0) as ss, pytest.warns(ProgramWarning, match="robto"):
        ss.eval(program)
