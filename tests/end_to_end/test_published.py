"""The problems that SelectScript was published with: four colours, and the Towers of Hanoi."""

from itertools import combinations

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

FIRST_FIVE = dict(list(SMALL.items())[:5])
MAPS = {"five": FIRST_FIVE, "eight": SMALL, "twelve": LARGE}
COLOURED = {name: problems.coloured(MAPS[name]) for name in ("five", "eight")}


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


@pytest.mark.parametrize("regions", MAPS.values(), ids=MAPS)
def test_a_map_can_be_drawn(regions):
    """Each region after three lies in a gap that all those that it borders surround."""
    first = frozenset(list(regions)[:3])
    gaps = [first, first]  # inside and outside
    for region, others in list(regions.items())[3:]:
        gap = min((gap for gap in gaps if gap >= set(others)), key=len)
        assert len(gap) == 3
        gaps.remove(gap)
        around = combinations(gap, 2) if len(others) == 3 else [others]
        gaps += [frozenset((*pair, region)) for pair in around]
        gaps += [gap | {region}] * (len(others) == 2)


def test_the_small_map_has_48_colourings():
    assert len(SMALL) == 8
    assert len(COLOURED["eight"]) == counted(SMALL) == SMALL_COLOURINGS == 48
    assert counted(SMALL, 3) == 0


@pytest.mark.slow
@pytest.mark.parametrize("size", COLOURED)
def test_flat_map(ss, size):
    assert ss.eval(problems.flat(MAPS[size])) == COLOURED[size]


@pytest.mark.slow
def test_nested_map(ss):
    assert ss.eval(problems.nested(FIRST_FIVE)) == COLOURED["five"]


@pytest.mark.parametrize("write", [problems.flat, problems.nested])
def test_a_map_is_one_statement(told, write):
    ss, statements = told
    assert ss.eval(write(SMALL)) == COLOURED["eight"]
    assert len([text for text in statements if "SELECT" in text]) == 1


@pytest.mark.slow
@pytest.mark.parametrize("write", [problems.flat, problems.nested])
def test_neighbours_of_another_map_with_the_same_interpreter(told, write):
    """The lists in variables may change between two runs of what was compiled."""
    ss, _ = told
    program = ss.compile(write(FIRST_FIVE).split(";", 1)[1])
    ss.eval(f"colours = {problems.COLOURS};")
    assert ss.eval(program) == COLOURED["five"]
    ss.eval("colours = ['red', 'green', 'blue'];")
    assert ss.eval(program) == []
    ss.eval("colours = [3, 1, 2, 0];")
    numbers = dict(zip(problems.COLOURS, [3, 1, 2, 0], strict=True))
    assert ss.eval(program) == [
        {region: numbers[colour] for region, colour in found.items()} for found in COLOURED["five"]
    ]


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

MOVES = [[0, 2], [0, 1], [2, 1], [0, 2], [1, 0], [1, 2], [0, 2]]
TOWERS = [
    [[3, 2, 1], [], []],
    [[3, 2], [], [1]],
    [[3], [2], [1]],
    [[3], [2, 1], []],
    [[], [2, 1], [3]],
    [[1], [2], [3]],
    [[1], [], [3, 2]],
]
BOTH = [list(row) for row in zip(MOVES, TOWERS, strict=True)]

# form: (program, the same in Python, result)
HANOI = {
    "plain": (problems.PLAIN, problems.plain, [MOVES]),
    "no cycle": (problems.NO_CYCLE, problems.no_cycle, [[part for row in BOTH for part in row]]),
    "unique": (
        problems.UNIQUE,
        problems.unique,
        [[{f"config{level}": row} for level, row in enumerate(BOTH, 1)]],
    ),
    "memorize": (problems.MEMORIZE, problems.memorized, [BOTH]),
}


@pytest.mark.parametrize("form", HANOI)
@pytest.mark.parametrize("move", [problems.move, problems.typed_move])
@pytest.mark.parametrize("evaluator", EVALUATORS)
def test_hanoi(form, move, evaluator):
    program, search, result = HANOI[form]
    assert search() == result
    with interpreter(move, **EVALUATORS[evaluator]) as ss:
        assert ss.eval(program) == result


@pytest.mark.parametrize("most", [8, 9])
@pytest.mark.parametrize("form", HANOI)
def test_longer_ways(ss, form, most, monkeypatch):
    """With more moves than it takes there are many ways: all are found, in the same order."""
    program, search, _ = HANOI[form]
    longer = program.replace("level == 7", f"level == {most}")
    longer = longer.replace("MEMORIZE 7", f"MEMORIZE {most}")
    monkeypatch.setattr(problems, "MAX_MOVES", most)
    expected = search()
    assert len(expected) > 1
    assert ss.eval(longer) == expected


@pytest.mark.slow
@pytest.mark.parametrize("form", ["plain", "no cycle"])
def test_hanoi_as_sql(told, form, monkeypatch):
    """A search through so short a list is no statement, unless it is made one."""
    monkeypatch.setattr("ssduck.interpreter.query_runner.FEW_ROWS", 0)
    ss, statements = told
    program, _, result = HANOI[form]
    assert ss.eval(program) == result
    assert len([text for text in statements if "RECURSIVE" in text]) == 1
