"""The problems of the benchmark, which SelectScript was published with; `scripts` has its programs."""

import pytest

import ssduck
from benchmarks import problems
from benchmarks.problems import LARGE, SMALL, SMALL_COLOURINGS

EVALUATORS = {"compiled": {}, "row by row": {"row_by_row": True}}


def interpreter(move=problems.move, **options):
    ss = ssduck.Interpreter(**options)
    ss.add_function("move", move)
    return ss


@pytest.fixture(scope="module", params=EVALUATORS)
def ss(request):
    with interpreter(**EVALUATORS[request.param]) as found:
        yield found


@pytest.fixture
def told():
    """An interpreter, and the statements that it runs."""
    statements = []
    with interpreter(problems.typed_move, tracer=statements.append) as found:
        statements.clear()
        yield found, statements


# -- four colours -----------------------------------------------------------------------------


def colourings(names, pairs, colours):
    """How many ways: those without one of the borders, less those alike on both sides of it."""
    if not pairs:
        return colours ** len(names)
    pair = next(iter(pairs))
    kept, gone = pair
    others = pairs - {pair}
    merged = frozenset(frozenset(kept if n == gone else n for n in other) for other in others)
    without = colourings(names, others, colours)
    return without - colourings(names - {gone}, merged, colours)


def counted(regions, colours=4):
    pairs = frozenset(map(frozenset, problems.borders(regions)))
    return colourings(frozenset(regions), pairs, colours)


@pytest.mark.parametrize("write", [problems.flat, problems.nested])
def test_a_map_is_one_statement(told, write):
    ss, statements = told
    expected = problems.coloured(SMALL)
    assert ss.eval(write(SMALL)) == expected
    assert len(expected) == counted(SMALL) == SMALL_COLOURINGS
    assert len([text for text in statements if "SELECT" in text]) == 1


@pytest.mark.slow
def test_large_map(told):
    ss, statements = told
    found = ss.eval(problems.flat(LARGE))
    assert len([text for text in statements if "SELECT" in text]) == 1
    assert len(found) == counted(LARGE)
    assert len({tuple(colours.values()) for colours in found}) == len(found)
    assert all(colours[a] != colours[b] for colours in found for a, b in problems.borders(LARGE))
    places = [[problems.COLOURS.index(c) for c in colours.values()] for colours in found]
    assert places == sorted(places)


# -- the Towers of Hanoi ----------------------------------------------------------------------

# form: (program, the same in Python)
HANOI = {
    "plain": (problems.PLAIN, problems.plain),
    "no cycle": (problems.NO_CYCLE, problems.no_cycle),
    "unique": (problems.UNIQUE, problems.unique),
    "memorize": (problems.MEMORIZE, problems.memorized),
}


@pytest.mark.parametrize("most", [7, 8, 9])
@pytest.mark.parametrize("form", HANOI)
def test_longer_ways(ss, form, most, monkeypatch):
    """With more moves than it takes there are many ways: all are found, in the same order."""
    program, search = HANOI[form]
    longer = program.replace("level == 7", f"level == {most}")
    longer = longer.replace("MEMORIZE 7", f"MEMORIZE {most}")
    monkeypatch.setattr(problems, "MAX_MOVES", most)
    expected = search()
    assert (len(expected) > 1) is (most > 7)
    assert ss.eval(longer) == expected


@pytest.mark.slow
@pytest.mark.parametrize("form", ["plain", "no cycle"])
def test_hanoi_as_sql(told, form, monkeypatch):
    """A search through so short a list is no statement, unless it is made one."""
    monkeypatch.setattr("ssduck.interpreter.query_runner.FEW_ROWS", 0)
    ss, statements = told
    program, search = HANOI[form]
    assert ss.eval(program) == search()
    assert len([text for text in statements if "RECURSIVE" in text]) == 1
