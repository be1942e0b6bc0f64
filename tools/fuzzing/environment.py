"""The world, the functions and the variables of the inputs, and correct programs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def _move(step: Any, tower: Any) -> Any:
    """Returns the position after a move of the Towers of Hanoi, [] for an invalid move."""
    source, target = tower[step[0]], tower[step[1]]
    if not source or (target and target[-1] < source[-1]):
        return []
    target.append(source.pop())
    return tower


def _strange(kind: Any) -> Any:
    """Returns values that no query expects."""
    import numpy as np

    endless: list[Any] = [1]
    endless.append(endless)
    kinds = (None, float("nan"), object(), float("inf"), np.zeros(2), {1, 2}, {3: {"a": None}})
    others = (10**30, b"\xff", 1j, "\ud800", "\x00", endless, np.float64(2.5), range(3), int)
    values = (*kinds, *others)
    return values[int(kind) % len(values)]


def _broken(value: Any) -> Any:
    raise KeyError(value)


def functions_of_inputs() -> dict[str, Callable[..., Any]]:
    from ssduck import Entity

    def plus(a: int, b: int) -> int:
        return a + b

    def half(a: float) -> float:
        return a / 2

    def shout(a: str) -> str:
        return a.upper() + "!"

    def total(values: list[float]) -> float:
        return sum(values)

    def height(e: Entity) -> float:
        (_, _, low), (_, _, high) = e.aabb
        return high - low

    def is_low(e: Entity, limit: float) -> bool:
        return e.position[2] < limit

    def huge_of(a: int) -> int:
        return a * 10**30

    def liar(a: int) -> str:
        return a  # type: ignore[return-value]  # the hint is wrong on purpose

    def double(value: Any) -> Any:
        return value * 2

    named = (plus, half, shout, total, height, is_low, huge_of, liar, double)
    functions: dict[str, Callable[..., Any]] = {function.__name__: function for function in named}
    for function in (plus, half, shout, total, height, is_low, huge_of, liar):
        hints = {"int": int, "float": float, "str": str, "bool": bool, "list[float]": list[float]}
        hints["Entity"] = Entity
        function.__annotations__ = {k: hints[v] for k, v in function.__annotations__.items()}
    return {**functions, "move": _move, "strange": _strange, "broken": _broken}


def variables_of_inputs() -> dict[str, Any]:
    import numpy as np
    import pandas as pd
    import polars as pl
    import pyarrow as pa

    moves = [[a, b] for a in range(3) for b in range(3) if a != b]
    return {
        "numbers": [3, 1, 2],
        "nested": [[1, 2], [3, 4]],
        "words": ["b", "a", "ä"],
        "mixed": [1, "a", None, 2.5, [1], True, {"a": 1}],
        "empty": [],
        "people": [{"name": "Ann", "age": 31}, {"name": "Bo", "age": 19}],
        "record": {"name": "x", "parts": [1, 2]},
        "frame": pd.DataFrame({"a": [1, 2, 3], "b": ["x", "y", None]}),
        "polar": pl.DataFrame({"a": [1, 2], "c": [0.5, float("nan")]}),
        "arrow": pa.table({"k": ["p", "q"], "v": [1.5, 2.5]}),
        "grid": np.arange(6).reshape(3, 2),
        "moves": moves,
        "edges": [["a", "b"], ["b", "c"], ["c", "d"], ["b", "a"]],
        "n": 3,
        "nan": float("nan"),
        "huge": 10**30,
        "text": "wörld",
        "flag": True,
        "nothing": None,
    }


def world_of_inputs() -> Any:
    """Returns a world of a robot and a few bodies."""
    import pybullet as p

    from ssduck import World
    from tests.support.bodies import create_linked_body

    client = p.connect(p.DIRECT)
    box = p.createCollisionShape(p.GEOM_BOX, halfExtents=[0.5, 0.5, 0.2], physicsClientId=client)
    ball = p.createCollisionShape(p.GEOM_SPHERE, radius=0.1, physicsClientId=client)
    names = {}
    for name, shape, place in (
        ("shelf", box, [0, 0, 0.2]),
        ("cup", ball, [0.1, 0, 0.5]),
        ("crate", box, [2, 1, 0.2]),
        ("ball", ball, [-1, 2, 0.1]),
    ):
        number = p.createMultiBody(1, shape, basePosition=place, physicsClientId=client)
        names[number] = name
    arm = create_linked_body(
        client,
        1,
        box,
        link_shape=ball,
        basePosition=[3, 3, 1],
        linkPositions=[[0, 0, 0.5]],
        linkJointTypes=[p.JOINT_REVOLUTE],
    )
    return World.attach(client, names={**names, arm: "arm"})


# Programs and their values, whatever ran before.
CORRECT = (
    ("n + 1;", 4),
    ("SELECT double(this) FROM numbers WHERE this > 1 AS list;", [6, 4]),
    ("SELECT id FROM room WHERE isKinbody(this) AND above(shelf, this) AS list;", ["cup"]),
    ("SELECT id(this) FROM room WHERE z(this) > n - 2.6 AS list;", ["cup", "arm"]),
    ("SELECT half(this) FROM [1.0, 5.0] AS list;", [0.5, 2.5]),
)
