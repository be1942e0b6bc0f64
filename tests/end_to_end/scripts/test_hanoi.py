"""Published scripts: the Towers of Hanoi."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

import ssduck
from tests.support.scripts import AFTER, HANOI, MOVES, TOWERS


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


@pytest.mark.parametrize("program", HANOI, ids=range(len(HANOI)))
def test_towers_of_hanoi(towers, program):
    assert towers.eval(towers.compile(program)) == HANOI[program]


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


MAXIMUM = """# stop at a certain number of results... note the changed graph-size
moves  = [[0,1], [0,2], [1,0], [1,2], [2,0], [2,1]];

SELECT mov.this, tower
FROM mov=moves
WHERE [[],[],[3,2,1]] == move( mov.this, tower )

START WITH tower = [[3,2,1],[],[]]
CONNECT BY MEMORIZE 10 MAXIMUM 3
           tower = move( mov.this, tower )
STOP WITH  [] == move( mov.this, tower )

AS dict; """

FOUR_DISCS = """
moves  = [[0,1], [0,2], [1,0], [1,2], [2,0], [2,1]];
              
SELECT mov.this, tower
FROM mov=moves
WHERE [[],[],[4,3,2,1]] == move( mov.this, tower )
              
START WITH tower = [[4,3,2,1],[],[]], level=1
CONNECT BY NO CYCLE tower = move( mov.this, tower ), level=level+1
STOP WITH  ([] == move( mov.this, tower )) or level==15
              
AS list; """  # noqa: W293


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
    found = towers.eval(towers.compile(MAXIMUM))
    assert len(found) == 3
    ways = [[step["mov"] for (step,) in path] for path in found]
    assert ways[0] == MOVES
    assert [len(way) for way in ways] == sorted(map(len, ways))
    assert all(is_way(way, 3) for way in ways)
    assert len({str(path) for path in found}) == 3


@pytest.mark.slow
def test_four_discs(towers):
    (path,) = towers.eval(towers.compile(FOUR_DISCS))
    assert path[::2] == solution(4)
