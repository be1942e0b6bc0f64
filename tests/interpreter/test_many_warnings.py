"""A program warns of its first probable mistakes, and of the number of the others."""

import warnings
from concurrent.futures import ThreadPoolExecutor

import pytest

import ssduck
from ssduck.errors import ProgramWarning
from ssduck.interpreter.episode_batches import collected_doubts
from ssduck.interpreter.execution import MAX_WARNINGS


@pytest.fixture
def ss():
    with ssduck.load("chaos") as ss:
        yield ss


def unknown(count, first=0):
    """Returns a query with so many names that nothing has."""
    names = ", ".join(f"'thing {number}'" for number in range(first, first + count))
    return f"SELECT this FROM chaos WHERE this IN ({names}) AS list;"


def warnings_of(ss, program):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ss.eval(program)
    assert {warning.category for warning in caught} <= {ProgramWarning}
    return [str(warning.message) for warning in caught]


def more(count):
    return f"and {count} more such warnings of this program"


# Mistakes of one statement are limited already, but not those of texts in lists, nor all statements'.
PROGRAMS = {
    "a list": unknown(MAX_WARNINGS + 7),
    "statements": "".join(unknown(1, first=number) for number in range(MAX_WARNINGS + 7)),
    "a program within": f"eval({unknown(MAX_WARNINGS + 6)!r}); {unknown(1, first=99)}",
}


@pytest.mark.parametrize("program", PROGRAMS.values(), ids=PROGRAMS)
def test_a_program_shows_the_first(ss, program):
    *first, last = warnings_of(ss, program)
    assert len(first) == len(set(first)) == MAX_WARNINGS
    assert all(f"'thing {number}'" in text for number, text in enumerate(first))
    assert last == more(7)


def test_as_many_as_are_shown_have_no_others(ss):
    assert len(warnings_of(ss, unknown(MAX_WARNINGS))) == MAX_WARNINGS


def test_the_next_program_has_its_own(ss):
    warnings_of(ss, unknown(MAX_WARNINGS + 7))
    (text,) = warnings_of(ss, unknown(1, first=99))
    assert "'thing 99'" in text
    with pytest.warns(ProgramWarning, match="thing_98"):
        ss.sql("SELECT id FROM entities WHERE name = 'thing_98'")


def test_an_explanation_and_a_failed_program_say_it_too(ss):
    assert warnings_of(ss, f"EXPLAIN {unknown(MAX_WARNINGS + 7)}")[-1] == more(7)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with pytest.raises(ssduck.SelectScriptError):
            ss.eval(unknown(MAX_WARNINGS + 5, first=100) + " 1 / 0 + none;")
    assert str(caught[-1].message) == more(5)


def test_a_warning_that_is_an_error_leaves_an_interpreter_for_others(ss):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.filterwarnings("error", message="and .* more such")
        with pytest.raises(ProgramWarning):
            ss.eval(unknown(MAX_WARNINGS + 7))
    with ThreadPoolExecutor(1) as other:
        assert other.submit(ss.eval, "1 + 1;").result(timeout=60) == 2


def test_collected_doubts_are_as_many(ss):
    with collected_doubts(ss) as doubts:
        assert warnings_of(ss, unknown(MAX_WARNINGS + 7)) == []
    assert len(doubts) == MAX_WARNINGS
