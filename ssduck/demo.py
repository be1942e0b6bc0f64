"""The questions that `ssduck demo` asks: those of SelectScript's tutorial, and general ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ssduck.scenes import Scene, shipped_scenes


@dataclass(frozen=True)
class Addition:
    """A Python function that becomes part of the language.

    Attributes:
        name: what programs call it.
        function: what it does.
        help: what `help('name')` tells.
    """

    name: str
    function: Callable[..., Any]
    help: str


@dataclass(frozen=True)
class Question:
    """One step of the demonstration; variables stay from one to the next.

    Attributes:
        asks: the question in plain words.
        program: the same in SelectScript, or in SQL.
        sql: whether it is SQL.
        addition: a function that is added before it is asked.
    """

    asks: str
    program: str
    sql: bool = False
    addition: Addition | None = None


def on(o1: Any, o2: Any) -> bool:
    """Whether the position of o2 is over the box of o1."""
    if o1 == o2:
        return False
    low, high = o1.aabb
    x, y, z = o2.position
    return bool(low[0] <= x <= high[0] and low[1] <= y <= high[1] and z >= high[2])


_ON = Addition(
    "onX",
    on,
    "Checks if the position of an object (o2) is above object (o1).\nUsage: onX(o1, o2) -> bool",
)

_ABOVE_EACH_OTHER = """\
SELECT a.name AS lower, b.name AS upper
FROM entities a, entities b
WHERE above(a, b) AND a.kind <> 'sensor' AND b.kind <> 'sensor'
ORDER BY a.id, b.id"""

KITCHEN = (
    Question("What is 1 + 2 * 3 - 4 / 5?", "1+2*3-4/5.;"),
    Question(
        "Which robots are there, and where?",
        "SELECT id, position, type FROM kitchen WHERE isRobot(this);",
    ),
    Question(
        "How large are the small things above the table?",
        """\
table = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;
SELECT volume FROM kitchen
WHERE above(table, this) AND volume(this) < 0.001
AS list;""",
    ),
    Question(
        "What is below the table?",
        "SELECT obj, volume FROM kitchen WHERE below(table, this) AS dict;",
    ),
    Question(
        "What is within the microwave?",
        """\
microwave = SELECT obj FROM kitchen WHERE id(this) == 'microwave' AS value;
SELECT obj, position FROM kitchen WHERE within(microwave, this) AS list;""",
    ),
    Question(
        "Can a Python function be a relation, too? This one is added as onX, with a help text.",
        "help('onX');",
        addition=_ON,
    ),
    Question(
        "What is on the table, and less than 1.3 m away from the robot that is to clean up?",
        """\
robot   = SELECT obj FROM kitchen WHERE id(this) == 'barrett_4918' AS value;
cleanUp = SELECT obj FROM kitchen
          WHERE onX(table, this) AND distance(robot, this) < 1.3
          AS list;""",
    ),
    Question(
        "What is above what? The same database, asked in SQL.",
        _ABOVE_EACH_OTHER + ";",
        sql=True,
    ),
)


def questions(scene: Scene) -> tuple[Question, ...]:
    """The tutorial's questions for the kitchen that comes with ssduck, else general ones."""
    if scene.path == shipped_scenes().get("kitchen"):
        return KITCHEN
    # The name of a scene is an identifier: nothing can be injected.
    return (
        Question(
            "Which robots are there, and where?",
            f"SELECT id, position, type FROM {scene.name} WHERE isRobot(this);",  # noqa: S608
        ),
        Question(
            "What are the ten highest things?",
            f"SELECT id, type, z FROM {scene.name} ORDER BY z DESC LIMIT 10;",  # noqa: S608
        ),
        Question(
            "What is above what? The first ten pairs, in SQL.",
            _ABOVE_EACH_OTHER + " LIMIT 10;",
            sql=True,
        ),
    )
