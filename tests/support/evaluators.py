"""Both evaluators on a small world, and whether they agree on a program."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ssduck
from ssduck.simulators.scenes import find_scene
from tests.support.choices import FUNCTIONS, HISTORIES, VARIABLES, Choices
from tests.support.grammar import program

# -- the world that they run on -----------------------------------------------------------------

_BOX = """<robot name="{name}"><link name="base"><inertial><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><box size="{size}"/></geometry></collision></link></robot>"""
# name, kind, size, position
_BODIES = (
    ("table", "kinbody", "2 2 0.5", (0.0, 0.0, 0.25)),
    ("box", "kinbody", "0.5 0.5 0.5", (0.25, 0.0, 0.75)),
    ("cup", "kinbody", "0.125 0.125 0.25", (0.25, 0.0, 0.75)),
    ("lamp", "kinbody", "0.1 0.1 0.7", (-0.5, 0.5, 1.3)),
    ("arm", "robot", "0.25 0.25 1", (3.0, 0.0, 0.5)),
)


def small_world(folder: Path) -> ssduck.World:
    """Five boxes and a sensor."""
    lines = ['name = "w"']
    for name, kind, size, place in _BODIES:
        (folder / f"{name}.urdf").write_text(_BOX.format(name=name, size=size), encoding="utf-8")
        lines.append(f'[[body]]\nname = "{name}"\nkind = "{kind}"\nurdf = "{name}.urdf"')
        lines.append(f"fixed = true\nposition = {list(place)}")
    eye = '[[sensor]]\nname = "eye"\ntype = "planar_laser"\non = "arm"\nmax_range = 4.0\n'
    lines.append(eye + "min_angle = 90\nmax_angle = 270\nresolution = 2")
    scene = folder / "scene.toml"
    scene.write_text("\n".join(lines), encoding="utf-8")
    return ssduck.World.load(find_scene(scene))


# -- both evaluators ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """What running a program came to: a value, or an error."""

    value: Any = None
    error: BaseException | None = None

    def __str__(self) -> str:
        if self.error is None:
            return repr(self.value)
        first = str(self.error).splitlines()[:1]
        return f"{type(self.error).__name__}: {''.join(first)}"

    @property
    def is_crash(self) -> bool:
        """Whether it is an error that is none of the language's."""
        return self.error is not None and not isinstance(self.error, ssduck.SelectScriptError)


class Evaluators:
    """Two interpreters with the same world, variables and functions.

    Args:
        world: the world.
    """

    def __init__(self, world: ssduck.World) -> None:
        self.world = world
        self.sql = ssduck.Interpreter()
        self.rows = ssduck.Interpreter(row_by_row=True)
        for interpreter in (self.sql, self.rows):
            interpreter.add_variable("w", world)
            for function in FUNCTIONS:
                interpreter.add_function(function.__name__, function)
        for assignments in HISTORIES:
            for interpreter in (self.sql, self.rows):
                interpreter.eval(" ".join(assignments))
            world.step(240)
        self._histories = {
            interpreter: {
                name: interpreter._execution.variables[name] for name in ("past", "trail")
            }
            for interpreter in (self.sql, self.rows)
        }

    def refresh(self, interpreter: ssduck.Interpreter) -> None:
        """Make the variables what they were before any program ran."""
        interpreter.eval("clear();")
        for name, (value, _) in VARIABLES.items():
            interpreter.add_variable(name, value)
        interpreter._execution.variables.update(self._histories[interpreter])
        interpreter.add_variable("box", self.world["box"])

    def outcome(self, interpreter: ssduck.Interpreter, text: str) -> Outcome:
        """What a program comes to; the variables are fresh."""
        self.refresh(interpreter)
        try:
            return Outcome(interpreter.eval(text))
        except Exception as error:  # noqa: BLE001  # whatever it is, it is compared
            return Outcome(error=error)

    def disagreement(self, text: str) -> str | None:
        """How the two differ on a program; None if they agree."""
        rows, sql = self.outcome(self.rows, text), self.outcome(self.sql, text)
        if agree(rows, sql, text):
            return None
        return f"{text}\n    row by row: {rows}\n    SQL: {sql}"

    def close(self) -> None:
        """Close both."""
        self.sql.close()
        self.rows.close()


@contextmanager
def evaluators() -> Iterator[Evaluators]:
    """Both evaluators on a small world; lists are sources of SQL, however short."""
    from ssduck.interpreter import query_runner as queries

    with ExitStack() as stack:
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("error")  # DuckDB refuses what was written, say
        warnings.simplefilter("ignore", ssduck.ProgramWarning)
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        few = queries.FEW_ROWS
        stack.callback(setattr, queries, "FEW_ROWS", few)
        queries.FEW_ROWS = 0
        both = Evaluators(small_world(Path(folder)))
        stack.callback(both.world.close)
        stack.callback(both.close)
        yield both


def agree(rows: Outcome, sql: Outcome, text: str) -> bool:
    """Checks whether SQL gives what row by row gives.

    An error row by row may be a value in SQL only in a program with AND, or with LIMIT: which
    side of AND is looked at first is not promised, nor are conditions of rows beyond a limit.
    """
    if rows.is_crash or sql.is_crash:
        return False
    if rows.error is None:
        return sql.error is None and is_same(rows.value, sql.value)
    return sql.error is not None or " AND " in text or " LIMIT " in text


def is_same(left: Any, right: Any) -> bool:
    """Checks whether two values are equal and of the same types, in the same order."""
    if type(left) is not type(right):
        return False
    if isinstance(left, dict):
        return is_same(list(left.items()), list(right.items()))
    if isinstance(left, list | tuple):
        return len(left) == len(right) and all(map(is_same, left, right))
    return bool(left == right) or (left != left and right != right)  # noqa: PLR0124  # no number


def shrunk(taken: Sequence[int], fails: Callable[[str], bool], attempts: int = 400) -> str:
    """Returns the smallest program near some choices that still fails."""
    best = list(taken)
    left = attempts

    def attempt(candidate: list[int]) -> bool:
        nonlocal best, left
        choices = Choices(lambda _: 0, candidate)
        text = program(choices)
        if left <= 0 or (len(choices.taken), choices.taken) >= (len(best), best):
            return False
        left -= 1
        if fails(text):
            best = choices.taken
            return True
        return False

    changed = True
    while changed and left > 0:
        changed = False
        for size in (16, 8, 4, 2, 1):
            place = 0
            while place < len(best):
                cut = best[:place] + best[place + size :]
                zeroed = best[:place] + [0] * size + best[place + size :]
                if attempt(cut) or attempt(zeroed[: len(best)]):
                    changed = True
                else:
                    place += 1
        for place in range(len(best)):
            if place >= len(best):
                break
            for smaller in (best[place] // 2, best[place] - 1):
                if smaller >= 0 and attempt([*best[:place], smaller, *best[place + 1 :]]):
                    changed = True
                    break
    return program(Choices(lambda _: 0, best))
