"""The tutorial's questions about the kitchen: each program, its SQL and its answer.

Scenes of other names are asked general questions.
"""

from __future__ import annotations

import inspect
import re
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table
from rich.text import Text

from ssduck.adapters.display import display_table, fitted_table, plain_console, readable
from ssduck.demos.results import Say, keep_picture, save
from ssduck.errors import ProgramWarning, UnsupportedError
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.opening import load
from ssduck.simulators.scenes import Scene, find_scene, shipped_scenes

# Keywords of SelectScript, SQL and Python that the demonstration highlights.
_KEYWORDS = (
    r"(?i)\b(SELECT|FROM|WHERE|ORDER BY|LIMIT|DESC|AS|AND|OR|NOT|TRUE|FALSE|def|if|return)\b"
)


class DemoQuestion(NamedTuple):
    """A question of the demonstration; variables persist between questions."""

    asks: str
    program: str  # in SelectScript or SQL
    sql: bool = False
    # A function that is added to the language first: its name, itself, its help.
    addition: tuple[str, Callable[..., Any], str] | None = None


def on(o1: Any, o2: Any) -> bool:
    """Checks whether the position of o2 is over the box of o1."""
    if o1 == o2:
        return False
    low, high = o1.aabb
    x, y, z = o2.position
    return bool(low[0] <= x <= high[0] and low[1] <= y <= high[1] and z >= high[2])


_ON = "Checks if the position of an object (o2) is above object (o1).\nUsage: onX(o1, o2) -> bool"

_ABOVE = """\
SELECT a.name AS lower, b.name AS upper
FROM entities a, entities b
WHERE above(a, b) AND a.kind <> 'sensor' AND b.kind <> 'sensor'
ORDER BY a.id, b.id"""

KITCHEN = (
    DemoQuestion("What is 1 + 2 * 3 - 4 / 5?", "1+2*3-4/5.;"),
    DemoQuestion(
        "Which robots are there, and where?",
        "SELECT id, position, type FROM kitchen WHERE isRobot(this);",
    ),
    DemoQuestion(
        "How large are the small things above the table?",
        """\
table = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;
SELECT volume FROM kitchen
WHERE above(table, this) AND volume(this) < 0.001
AS list;""",
    ),
    DemoQuestion(
        "What is below the table?",
        "SELECT obj, volume FROM kitchen WHERE below(table, this) AS dict;",
    ),
    DemoQuestion(
        "What is within the microwave?",
        """\
microwave = SELECT obj FROM kitchen WHERE id(this) == 'microwave' AS value;
SELECT obj, position FROM kitchen WHERE within(microwave, this) AS list;""",
    ),
    DemoQuestion(
        "Can a Python function be a relation, too? This one is added as onX, with a help text.",
        "help('onX');",
        addition=("onX", on, _ON),
    ),
    DemoQuestion(
        "What is on the table, and less than 1.3 m away from the robot that is to clean up?",
        """\
barrett = SELECT obj FROM kitchen WHERE id(this) == 'barrett_4918' AS value;
cleanUp = SELECT obj FROM kitchen
          WHERE onX(table, this) AND distance(barrett, this) < 1.3
          AS list;""",
    ),
    DemoQuestion("What is above what? The same database, asked in SQL.", f"{_ABOVE};", sql=True),
)
# For other scenes, whose name is put into them.
GENERAL = (
    DemoQuestion(
        "Which robots are there, and where?",
        "SELECT id, position, type FROM {} WHERE isRobot(this);",
    ),
    DemoQuestion(
        "What are the ten highest things?", "SELECT id, type, z FROM {} ORDER BY z DESC LIMIT 10;"
    ),
    DemoQuestion(
        "What is above what? The first ten pairs, in SQL.", f"{_ABOVE} LIMIT 10;", sql=True
    ),
)


def questions(scene: Scene) -> tuple[DemoQuestion, ...]:
    """Returns the tutorial's questions for the shipped kitchen, general ones for other scenes."""
    if scene.path == shipped_scenes().get("kitchen"):
        return KITCHEN
    # The name of a scene is an identifier: nothing can be injected.
    return tuple(each._replace(program=each.program.format(scene.name)) for each in GENERAL)


def run(folder: Path, say: Say, *, seed: int) -> bool:  # noqa: ARG001
    """Asks the kitchen the tutorial's questions and draws it; uses no random numbers."""
    ask(find_scene("kitchen"), say, folder)
    return True


def ask(
    scene: Scene, say: Say, folder: Path | None, picture: Path | None = None, with_sql: bool = True
) -> None:
    """Asks the questions about a scene and draws the scene."""
    console = plain_console()
    scene_questions = questions(scene)
    with load(scene.path) as ss, warnings.catch_warnings():
        warnings.simplefilter("ignore", ProgramWarning)  # the tutorial's programs are as published
        seconds = 0.0
        for number, question in enumerate(scene_questions, 1):
            with console.capture() as captured:
                console.print(f"{number}. {question.asks}", style="bold")
                seconds += _demonstrate(ss, question, console, with_sql)
            # Padding at the ends of lines hinders copying and comparing.
            say(re.sub(r" +$", "", captured.get(), flags=re.MULTILINE))
        say(f"{len(scene_questions)} questions in {seconds:.2f} s")
        if picture is None and folder is None:
            return
        try:
            pixels = ss.call_variable(scene.name).render()
        except UnsupportedError as error:
            if picture is not None:
                raise
            say(f"The scene is not drawn: {error.message}")
            return
    if picture is not None:
        save(pixels, picture)
    elif folder is not None:
        picture = keep_picture(pixels, folder / f"{scene.name}.png")
    say(f"The scene is drawn in {picture}")


def _demonstrate(
    ss: Interpreter, question: DemoQuestion, console: Console, with_sql: bool
) -> float:
    """Asks a question and shows it with its answer; returns the time of the answer, s."""
    addition = question.addition
    if addition is not None:
        ss.add_function(*addition)
    start = time.perf_counter()
    value = ss.sql(question.program) if question.sql else ss.eval(question.program)
    seconds = time.perf_counter() - start
    table = replace(display_table(value), types=())

    grid = Table.grid(padding=(0, 2, 1, 0))
    grid.add_column(style="dim", min_width=9)
    grid.add_column(overflow="fold")
    if addition is not None:
        grid.add_row("  Python", _highlighted(inspect.getsource(addition[1])))
    grid.add_row("  SQL" if question.sql else "  program", _highlighted(question.program))
    if with_sql and not question.sql and (sql := ss.explain(question.program)):
        grid.add_row("  as SQL", _compact(sql), style="dim")
    grid.add_row("  answer", fitted_table(table) if table.named else readable(value))
    console.print(grid)
    return seconds


def _highlighted(code: str) -> Text:
    text = Text(code.strip())
    text.highlight_regex(_KEYWORDS, "cyan")
    text.highlight_regex(r"'[^']*'|\"[^\"]*\"", "green")
    return text


def _compact(sql: str) -> str:
    """Returns SQL with one line for each clause."""
    joined = re.sub(r"\n\s+(?=\S)", " ", re.sub(r"\n\s+(?=\))", "", sql))
    return joined.replace("( ", "(")
