"""Published scripts: the Towers of Hanoi."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

import ssduck

MOVES = [[0, 2], [0, 1], [2, 1], [0, 2], [1, 0], [1, 2], [0, 2]]
# The published towers are those after the move, since the authors' `move` changes them in place;
# here a row sees the towers before its move.
AFTER = [
    [[3, 2], [], [1]],
    [[3], [2], [1]],
    [[3], [2, 1], []],
    [[], [2, 1], [3]],
    [[1], [2], [3]],
    [[1], [], [3, 2]],
    [[], [], [3, 2, 1]],
]
TOWERS = [[[3, 2, 1], [], []], *AFTER[:-1]]
STEPS = [{"mov": mov, "tower": tower} for mov, tower in zip(MOVES, TOWERS, strict=True)]


def numbered(word):
    """The steps of the way, each under a word and its level."""
    return [{f"{word}{n}": [*step.values()]} for n, step in enumerate(STEPS, 1)]


PROGRAM = """# {how}: as published
moves  = [[0,1], [0,2], [1,0], [1,2], [2,0], [2,1]];

SELECT {selected}
FROM mov=moves
WHERE [[],[],[3,2,1]] == move( mov.this, tower )

START WITH tower = [[3,2,1],[],[]], level=1                # the local level variable
CONNECT BY {how}
           tower = move( mov.this, tower ), level=level+1  # is required to prevent
STOP WITH  level==7 or []==move(mov.this, tower)           # an infinite recursion

AS {form}; """


def written(how, selected="mov.this, tower", form="dict"):
    """A published program; one with MEMORIZE needs no level."""
    program = PROGRAM.format(how=how, selected=selected, form=form)
    for part in (", level=1 ", ", level=level+1", "level==7 or ") if "MEMORIZE" in how else ():
        program = program.replace(part, " ")
    return program


CONFIG = 'to([mov.this, tower], "{}"+str(level))'
# (how, what is selected, the form, the paths)
HANOI = [
    ("", "mov.this", "list", [MOVES]),
    ("NO CYCLE", "mov.this, tower", "dict", [STEPS]),
    ("UNIQUE", CONFIG.format("config"), "dict", [numbered("config")]),
    ("NO CYCLE UNIQUE", CONFIG.format("config"), "dict", [numbered("config")]),
    ("MEMORIZE", "mov.this, tower", "dict", [[[step] for step in STEPS]]),
    ("MEMORIZE 7", "mov.this, tower", "dict", [[[step] for step in STEPS]]),
    ("", CONFIG.format("move"), "dict", [numbered("move")]),
]


def move(step, towers):
    """The function of the scripts; it changes what it is given, which is a copy here."""
    if not towers or not towers[step[0]]:
        pass
    elif not towers[step[1]] or towers[step[1]][-1] > towers[step[0]][-1]:
        towers[step[1]].append(towers[step[0]].pop())
        return towers
    return []


NESTED = """# Basic nested functions iterating over all combinations, not very effective
moves  = [[0,1], [0,2], [1,0], [1,2], [2,0], [2,1]];

SELECT mov1.this, mov2.this, mov3.this, mov4.this, mov5.this, mov6.this, mov7.this
FROM mov1=moves, mov2=moves, mov3=moves, mov4=moves, mov5=moves, mov6=moves, mov7=moves
WHERE [[],[],[3,2,1]] == move( mov7.this,
                               move( mov6.this,
                                     move( mov5.this,
                                           move( mov4.this,
                                                 move( mov3.this,
                                                       move( mov2.this,
                                                             move( mov1.this, [[3,2,1],[],[]] )))))))
AS list; """


@pytest.fixture
def towers(ss):
    ss.addFunction("move", move)
    ss.addFunction("str", str)  # the language's own; nothing is replaced, nothing is told
    return ss


@pytest.mark.parametrize(("how", "selected", "form", "paths"), HANOI)
def test_towers_of_hanoi(towers, how, selected, form, paths):
    assert towers.eval(towers.compile(written(how, selected, form))) == paths


def test_published_towers_are_those_after_the_move():
    assert [
        move(mov, [list(pile) for pile in before])
        for mov, before in zip(MOVES, TOWERS, strict=True)
    ] == AFTER


@pytest.mark.long
def test_towers_by_nested_functions():
    """280,000 rows, and as many calls as there are distinct arguments of them."""
    calls = []

    def counted(step, towers):
        calls.append(step)
        return move(step, towers)

    with ssduck.Interpreter() as ss:
        ss.addFunction("move", counted)
        assert ss.eval(ss.compile(NESTED)) == MOVES
    # The 27 towers and none, by six moves.
    assert len(calls) <= 28 * 6


def solution(discs: int, source: int = 0, target: int = 2) -> list[list[int]]:
    """The shortest way, as everybody knows it."""
    if not discs:
        return []
    other = 3 - source - target
    before, after = solution(discs - 1, source, other), solution(discs - 1, other, target)
    return [*before, [source, target], *after]


def is_way(moves: Sequence[Sequence[int]], discs: int) -> bool:
    """Whether these moves are possible, and carry all discs to the last place."""
    towers = [list(range(discs, 0, -1)), [], []]
    for mov in moves:
        towers = move(mov, towers)
        if not towers:
            return False
    return towers == [[], [], list(range(discs, 0, -1))]


def test_as_many_results_as_are_wanted(towers):
    """The shortest come first here; the published ones (11, 7 and 9 moves) are in no order."""
    found = towers.eval(towers.compile(written("MEMORIZE 10 MAXIMUM 3")))
    assert len(found) == 3
    ways = [[step["mov"] for (step,) in path] for path in found]
    assert ways[0] == MOVES
    assert [len(way) for way in ways] == sorted(map(len, ways))
    assert all(is_way(way, 3) for way in ways)
    assert len({str(path) for path in found}) == 3


@pytest.mark.slow
def test_four_discs(towers):
    program = written("NO CYCLE", form="list")
    program = program.replace("[3,2,1]", "[4,3,2,1]").replace("level==7", "level==15")
    (path,) = towers.eval(towers.compile(program))
    assert path[::2] == solution(4)
