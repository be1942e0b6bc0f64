"""Defines two benchmarks of SelectScript: four colours on a map, and the Towers of Hanoi.

A part of `benchmarks.language`, which measures them. Each problem is a program and a plain Python
function with the same value. The maps are invented.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from itertools import product
from typing import Any, TypeAlias

# -- four colours -----------------------------------------------------------------------------

COLOURS = ["red", "green", "blue", "yellow"]
# Each region with its neighbours among the regions before it. Each can be drawn in a gap between
# these neighbours, so the map is planar.
SMALL = {
    "coast": (),
    "marsh": ("coast",),
    "forest": ("coast", "marsh"),
    "hills": ("coast", "marsh", "forest"),
    "moor": ("marsh", "forest", "hills"),
    "castle": ("coast", "forest", "hills"),
    "vineyard": ("forest", "hills", "castle"),
    "cape": ("coast", "marsh"),
}
LARGE = SMALL | {
    "quarry": ("coast", "castle"),
    "village": ("hills", "castle", "vineyard"),
    "orchard": ("forest", "moor"),
    "reef": ("marsh", "cape"),
}
# 4! ways to colour the regions that border three others; the cape is left two colours.
SMALL_COLOURINGS = 48

Map: TypeAlias = dict[str, tuple[str, ...]]


def borders(regions: Map) -> list[tuple[str, str]]:
    """Returns the pairs of neighbouring regions."""
    return [(other, region) for region, others in regions.items() for other in others]


def flat(regions: Map) -> str:
    """Returns a query for the colourings: a source for each region, a condition for each border."""
    conditions = " AND ".join(f"{a}.this != {b}.this" for a, b in borders(regions))
    return f"colours = {COLOURS}; {_selected(regions)} WHERE {conditions};"


def nested(regions: Map) -> str:
    """Returns the same query with the borders in a list and a subquery in WHERE."""
    pairs = ", ".join(f"[{a}.this, {b}.this]" for a, b in borders(regions))
    alike = "SELECT n.this FROM n=neighbours WHERE n.this[0] == n.this[1] AS list"
    return (
        f"colours = {COLOURS}; neighbours = [{pairs}]; {_selected(regions)} WHERE [] == ({alike});"
    )


def _selected(regions: Map) -> str:
    items = ", ".join(f"to({region}.this, '{region}')" for region in regions)
    sources = ", ".join(f"{region}=colours" for region in regions)
    return f"SELECT {items} FROM {sources}"  # no SQL yet


def coloured(regions: Map) -> list[dict[str, str]]:
    """Returns the colourings by a plain loop over all combinations."""
    names = list(regions)
    pairs = [(names.index(a), names.index(b)) for a, b in borders(regions)]
    return [
        dict(zip(names, colours, strict=True))
        for colours in product(COLOURS, repeat=len(names))
        if all(colours[a] != colours[b] for a, b in pairs)
    ]


# -- the Towers of Hanoi ----------------------------------------------------------------------

MOVES = [[0, 1], [0, 2], [1, 0], [1, 2], [2, 0], [2, 1]]
START = [[3, 2, 1], [], []]
GOAL = [[], [], [3, 2, 1]]
MAX_MOVES = 7

Tower: TypeAlias = list[list[int]]
Key: TypeAlias = tuple[tuple[int, ...], ...]


def move(mov, tower):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201  # as most write it
    """Returns the towers after a move; [] where it is impossible."""
    source, target = mov
    if not tower[source] or (tower[target] and tower[target][-1] < tower[source][-1]):
        return []
    after = [list(pile) for pile in tower]
    after[target].append(after[source].pop())
    return after


def typed_move(mov: list[int], tower: list[list[int]]) -> list[list[int]]:
    """Returns the same, with types."""
    return move(mov, tower)  # type: ignore[no-any-return, no-untyped-call]


_HANOI = """
    moves = [[0,1],[0,2],[1,0],[1,2],[2,0],[2,1]];
    SELECT {selected} FROM mov=moves
    WHERE [[],[],[3,2,1]] == move(mov.this, tower)
    START WITH tower = [[3,2,1],[],[]], level = 1
    CONNECT BY {how} tower = move(mov.this, tower), level = level+1
    STOP WITH  level == 7 OR [] == move(mov.this, tower)
    {form};
"""
PLAIN = _HANOI.format(selected="mov.this", how="", form="AS list")
NO_CYCLE = _HANOI.format(selected="mov.this, tower", how="NO CYCLE", form="AS list")
UNIQUE = _HANOI.format(selected='to([mov.this, tower], "config"+str(level))', how="UNIQUE", form="")
MEMORIZE = _HANOI.format(selected="mov.this, tower", how="MEMORIZE 7", form="AS list")


def _key(mov: list[int], tower: Tower) -> Key:
    return (tuple(mov), *map(tuple, tower))


def plain() -> list[list[list[int]]]:
    """Searches depth first, whatever was there before."""

    def paths(tower: Tower, path: list[list[int]]) -> Iterator[list[list[int]]]:
        for mov in MOVES:
            after = move(mov, tower)  # type: ignore[no-untyped-call]
            if after == GOAL:
                yield [*path, mov]
            elif after and len(path) + 1 < MAX_MOVES:
                yield from paths(after, [*path, mov])

    return list(paths(START, []))


def no_cycle() -> list[list[Any]]:
    """Searches depth first, no move from the same towers twice in a path."""
    visited: set[Key] = set()

    def paths(tower: Tower, path: list[Any], level: int) -> Iterator[list[Any]]:
        for mov in MOVES:
            key = _key(mov, tower)
            if key in visited:
                continue
            after = move(mov, tower)  # type: ignore[no-untyped-call]
            if after == GOAL:
                yield [*path, mov, tower]
            elif after and level < MAX_MOVES:
                visited.add(key)
                yield from paths(after, [*path, mov, tower], level + 1)
                visited.remove(key)

    return list(paths(START, [], 1))


def unique() -> list[list[dict[str, Any]]]:
    """Searches depth first, no move from the same towers twice at a level."""
    visited: set[tuple[Key, int]] = set()

    def paths(tower: Tower, path: list[Any], level: int) -> Iterator[list[Any]]:
        for mov in MOVES:
            key = (_key(mov, tower), level)
            if key in visited:
                continue
            after = move(mov, tower)  # type: ignore[no-untyped-call]
            here = [*path, {f"config{level}": [mov, tower]}]
            if after and level < MAX_MOVES:
                visited.add(key)
            if after == GOAL:
                yield here
            elif after and level < MAX_MOVES:
                yield from paths(after, here, level + 1)

    return list(paths(START, [], 1))


def memorized() -> list[list[list[Any]]]:
    """Searches breadth first to a graph of moves, then its simple paths, shortest first."""
    rows: dict[Key, list[Any]] = {}
    following: dict[Key, list[Key]] = {}
    preceding: dict[Key, list[Key]] = {}
    goals: list[Key] = []
    waiting: deque[tuple[Key | None, Tower, int]] = deque([(None, START, 1)])
    roots: list[Key] = []
    while waiting:
        before, tower, level = waiting.popleft()
        reached = roots if before is None else following.setdefault(before, [])
        for mov in MOVES:
            key = _key(mov, tower)
            if key not in rows:
                after = move(mov, tower)  # type: ignore[no-untyped-call]
                if after == GOAL:
                    goals.append(key)
                elif not after or level == MAX_MOVES:
                    continue
                else:
                    waiting.append((key, after, level + 1))
                rows[key] = [mov, tower]
            reached.append(key)
            if before is not None:
                preceding.setdefault(key, []).append(before)

    distances = dict.fromkeys(goals, 0)
    nearer = deque(goals)
    while nearer:
        key = nearer.popleft()
        for earlier in preceding.get(key, ()):
            if earlier not in distances:
                distances[earlier] = distances[key] + 1
                nearer.append(earlier)

    def simple(path: list[Key], keys: Iterable[Key], left: int) -> Iterator[list[Key]]:
        for key in keys:
            if distances.get(key, left) >= left or key in path:
                continue
            if distances[key] == 0:
                if left == 1:
                    yield [*path, key]
            else:
                yield from simple([*path, key], following[key], left - 1)

    return [
        [rows[key] for key in path]
        for length in range(1, MAX_MOVES + 1)
        for path in simple([], roots, length)
    ]
