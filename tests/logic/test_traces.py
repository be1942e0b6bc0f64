"""The operators of temporal logic on arrays, and tick by tick, are those of the definitions."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ssduck.logic import traces
from ssduck.logic.stepwise import HeldSince, UntilFromFirst
from ssduck.logic.traces import Trace, Window
from tests.support.cases import generated
from tests.support.temporal_logic import Formula, value

OPERATORS = {
    "always": traces.always,
    "eventually": traces.eventually,
    "until": traces.until,
    "once": traces.once,
    "historically": traces.historically,
    "heldSince": traces.held_since,
}
A, B = Formula("a"), Formula("b")
STEPS = st.lists(st.sampled_from([0.1, 0.1, 0.25, 0.5]), max_size=12)
BOUNDS = st.sampled_from([0.0, 0.1, 0.2, 0.3, 0.35, 1.0])


@st.composite
def windows(draw):
    start = draw(BOUNDS)
    return Window(start, draw(st.sampled_from([math.inf, start + draw(BOUNDS)])))


def times_of(steps):
    return np.cumsum([0.0, *steps])


def numbers(count):
    return st.lists(st.integers(-3, 3), min_size=count, max_size=count)


def formula_of(name, window):
    parts = (A, B) if name in ("until", "heldSince") else (A,)
    return Formula(name, parts, (window.start, window.end))


@settings(max_examples=generated(150), deadline=None)
@given(STEPS, windows(), st.sampled_from(sorted(OPERATORS)), st.booleans(), st.data())
def test_a_trace_is_that_of_the_definition(steps, window, name, is_open, data):
    times = times_of(steps)
    truth = st.lists(st.sampled_from([True, False, None]), min_size=len(times), max_size=len(times))
    signals = {"a": data.draw(truth), "b": data.draw(truth)}
    formula = formula_of(name, window)
    conditions = [
        Trace.of(
            times,
            np.array([one is True for one in signals[part.name]]),
            np.array([one is None for one in signals[part.name]]),
            is_open=is_open,
        )
        for part in formula.parts
    ]
    found = OPERATORS[name](*conditions, window)
    values = [
        bool(low) if low == high else None for low, high in zip(found.low, found.high, strict=True)
    ]
    assert values == [
        value(formula, tick, times.tolist(), signals, is_open=is_open) for tick in range(len(times))
    ]


@settings(max_examples=generated(150), deadline=None)
@given(STEPS, windows(), st.sampled_from(sorted(OPERATORS)), st.data())
def test_a_margin_is_more_than_each_number_that_the_condition_exceeds(steps, window, name, data):
    """By the definition of margins: `margin > m` is the condition with margins less m."""
    times = times_of(steps)
    count = len(times)
    margins = [np.array(data.draw(numbers(count)), float) for _ in range(2)]
    formula = formula_of(name, window)
    parts = margins[: len(formula.parts)]
    found = OPERATORS[name](*(Trace.of(times, part) for part in parts), window)
    assert found.low is found.high
    for level in np.arange(-3.5, 4.0):
        signals = {
            part.name: list(map(bool, m > level)) for part, m in zip((A, B), margins, strict=True)
        }
        holds = [
            value(formula, tick, times.tolist(), signals, is_open=False) for tick in range(count)
        ]
        assert (found.low > level).tolist() == holds


@settings(max_examples=generated(100), deadline=None)
@given(STEPS, windows(), st.integers(0, 12), st.data())
def test_a_tick_more_changes_a_state_as_all_ticks_make_it(steps, window, known, data):
    times = times_of(steps)
    values, starts = (np.array(data.draw(numbers(len(times))), float) for _ in range(2))
    expected = traces.held_since(Trace.of(times, values), Trace.of(times, starts), window).low
    known = min(known, len(times))
    state = HeldSince(window)
    if known:
        state = state.after(times[:known], values[:known], starts[:known])
        assert state.margin == expected[known - 1]
    ticks = zip(times.tolist(), values.tolist(), starts.tolist(), strict=True)
    for tick, (time, held, start) in list(enumerate(ticks))[known:]:
        state = state.step(time, held, start)
        assert state.margin == expected[tick]


@settings(max_examples=generated(100), deadline=None)
@given(STEPS, windows(), st.integers(0, 12), st.data())
def test_until_at_the_first_tick_is_known_tick_by_tick(steps, window, known, data):
    times = times_of(steps)
    values, goals = (np.array(data.draw(numbers(len(times))), float) for _ in range(2))
    known = min(known, len(times))
    states = [UntilFromFirst(window, is_upper=is_upper) for is_upper in (False, True)]
    states = [state.after(times[:known], values[:known], goals[:known]) for state in states]
    ticks = zip(times.tolist(), values.tolist(), goals.tolist(), strict=True)
    for tick, (time, held, goal) in list(enumerate(ticks))[known:]:
        states = [state.step(time, held, goal) for state in states]
        so_far = (
            Trace.of(times[: tick + 1], part[: tick + 1], is_open=True) for part in (values, goals)
        )
        expected = traces.until(*so_far, window)
        assert [state.margin for state in states] == [expected.low[0], expected.high[0]]


@settings(max_examples=generated(400), deadline=None)
@given(STEPS, windows(), st.sampled_from(["until", "until", "always", "eventually"]), st.data())
def test_what_is_decided_is_what_all_that_may_come_makes_it(steps, window, name, data):
    times = times_of(steps)
    count = data.draw(st.integers(1, len(times)))
    truth = st.lists(st.booleans(), min_size=len(times), max_size=len(times))
    drawn = [data.draw(truth) for _ in formula_of(name, window).parts]
    whole = OPERATORS[name](*(Trace.of(times, np.array(one)) for one in drawn), window)
    so_far = [Trace.of(times[:count], np.array(one[:count]), is_open=True) for one in drawn]
    found = OPERATORS[name](*so_far, window)
    assert (found.low <= whole.low[:count]).all()
    assert (whole.low[:count] <= found.high).all()


def test_several_episodes_are_each_by_itself():
    times = np.arange(20) * 0.1
    values, goals = np.random.default_rng(0).normal(size=(2, 5, 20))
    for name, operator in OPERATORS.items():
        whole = [Trace.of(times, values), Trace.of(times, goals)]
        parts = whole if name in ("until", "heldSince") else whole[:1]
        together = operator(*parts, Window(0.2, 0.7)).low
        for row in range(5):
            alone = [Trace.of(times, part.low[row]) for part in parts]
            np.testing.assert_array_equal(together[row], operator(*alone, Window(0.2, 0.7)).low)


def test_in_an_empty_window_always_holds_and_eventually_does_not():
    trace = Trace.of(np.array([0.0, 1.0]), np.array([True, True]))
    behind = Window(1.5, 3.0)
    assert traces.eventually(trace, behind).low.tolist() == [False, False]
    assert traces.always(~trace, behind).low.tolist() == [True, True]
    assert traces.once(trace, behind).low.tolist() == [False, False]
    assert traces.historically(~trace, behind).low.tolist() == [True, True]
