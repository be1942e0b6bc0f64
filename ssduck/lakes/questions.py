"""What a lake is asked: a program, or the terms of a task. Any process can answer it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, TypeAlias

import numpy as np

from ssduck.adapters.display import RowsOfColumns
from ssduck.errors import ArgumentError, RecordError, UnknownNameError
from ssduck.formatting import short_repr
from ssduck.gym.judge import Judge, looks_ahead
from ssduck.gym.scoring import EpisodeScore, score_with
from ssduck.gym.terms import Terms
from ssduck.interpreter.episode_batches import reads_present
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.program import CompiledProgram
from ssduck.lakes.manifest import EpisodeEntry
from ssduck.language import ast
from ssduck.language.parser import parse
from ssduck.limits import Limits
from ssduck.recording.episode_steps import EpisodeSteps
from ssduck.recording.paths import expand_path
from ssduck.validation import text
from ssduck.world.handles import Handle
from ssduck.world.world import World

# Answers about an episode, given the interpreter that has its world at the last tick.
Answering: TypeAlias = Callable[[Interpreter, EpisodeEntry], Any]
# What a batch, one record of many episodes, tells otherwise than each of them: it numbers their
# ticks one after another, and is one run. A text of eval and a name of var may be of these.
_NOT_IN_BATCHES = frozenset(("tick", "run", "eval", "var"))


@dataclass(frozen=True)
class ProgramQuestion:
    """A program, whose value is the answer."""

    text: str  # the program
    limits: Limits | None = None  # the limits of the program
    is_strict: bool = False  # whether a probable mistake in it is an error

    def __post_init__(self) -> None:
        text(self.text, "a program for a lake is a text of SelectScript")
        _ = self._tree  # fails if the text is no program

    @property
    def key(self) -> str:
        """What tells it from other questions."""
        return repr((self.text, self.limits, self.is_strict))

    @property
    def _tree(self) -> ast.Program:
        return parse(self.text)

    @property
    def is_batchable(self) -> bool:
        """Whether episodes may be one record while they answer it."""
        tree = self._tree
        return not tree.explain and not any(map(_tells_episodes_apart, tree.statements))

    @property
    def reads_present(self) -> bool:
        """Whether it reads more of the last tick than its time."""
        return reads_present(self._tree)

    def answering(self, interpreter: Interpreter) -> Answering:
        """Returns a function that answers about episodes; the program is compiled once."""
        program = replace(interpreter.compile(self.text), tree=self._tree)

        def answer(present: Interpreter, entry: EpisodeEntry) -> Any:
            try:
                return plain(self._answer(present, program, entry))
            except UnknownNameError as error:
                add_hint_of_episode(error, self._tree, entry)
                raise

        return answer

    def _answer(self, present: Interpreter, program: CompiledProgram, _: EpisodeEntry) -> Any:
        return present.eval(program)


class ConditionQuestion(ProgramQuestion):
    """A condition; the answer has its values at the first tick and at changes, or at all ticks."""

    @property
    def key(self) -> str:
        """What tells it from other questions."""
        return f"condition {super().key}"

    @property
    def _tree(self) -> ast.Program:
        tree = super()._tree
        if len(tree.statements) != 1 or tree.explain:
            raise ArgumentError(f"lint: {self.text!r} is to be one expression")
        node = tree.statements[0]
        if _is_series(node):
            call = ast.Call(node.span, "changes", (node,), node.span)
            return replace(tree, statements=(call,))
        if looks_ahead(node):
            raise ArgumentError(
                f"lint: {self.text!r} has a query or a past, so that it is asked at each tick, and "
                "an operator that looks ahead, which needs all ticks: ask for one of them at a time"
            )
        return tree

    def _answer(self, present: Interpreter, program: CompiledProgram, entry: EpisodeEntry) -> Any:
        if _is_series(program.tree.statements[0]):
            return [value for _, value in present.eval(program)]
        world = present[entry.world]
        ticks = world.ticker.record.ticks.numbers.tolist()
        return [present.eval(program) for tick in ticks if world.seek_tick(tick)]


def _is_series(condition: ast.Node) -> bool:
    """Checks whether `changes` takes a condition: it has a part of a world, and no query."""
    kinds = set(map(type, condition.walk()))
    return ast.Index in kinds and kinds.isdisjoint((ast.Query, ast.TimeIndex))


def add_hint_of_episode(error: UnknownNameError, program: ast.Program, entry: EpisodeEntry) -> None:
    """Adds to the error for a name what an episode has of that name: a column, a variable."""
    parts = (part for statement in program.statements for part in statement.walk())
    names = {part.name for part in parts if isinstance(part, ast.Name) and part.span == error.span}
    columns = {*entry.tags, *(field.name for field in fields(entry))} - {"group", "files"}
    for name in names:
        if name in columns:
            told = (
                f"{name} is a column of lake.episodes, whose rows have the path, world and episode "
                f"of the answers; the argument where chooses by it: where='{name} = …'"
            )
        elif name in _variables_of(entry):
            told = (
                f"{name} is a variable of the environment, which has a value for each step: "
                "lake.score has it in its terms, as in lake.score(success='x(sim.ball) > goal')"
            )
        else:
            continue
        error.message, error.suggestions = f"{error.message}; {told}", ()


def _variables_of(entry: EpisodeEntry) -> Collection[str]:
    """Returns the names of the variables that an environment recorded in an episode."""
    try:
        steps = EpisodeSteps.read(expand_path(entry.path), entry.world, entry.episode)
    except RecordError:
        return ()
    return steps.variables


def _tells_episodes_apart(node: ast.Node) -> bool:
    """Checks whether a part names what is not the same in a batch of episodes."""
    name = node.key if isinstance(node, ast.QualifiedName) else getattr(node, "name", None)
    return name in _NOT_IN_BATCHES or any(map(_tells_episodes_apart, node.children()))


@dataclass(frozen=True)
class ScoreQuestion:
    """The terms of a task, evaluated after each step of an episode of `ssduck.gym`."""

    terms: Terms
    limits: Limits | None = None  # the limits of the terms
    is_strict: ClassVar[bool] = True  # see `ProgramQuestion`; terms are always strict

    @property
    def key(self) -> str:
        """What tells it from other questions."""
        return repr((self.terms.texts, self.limits))

    @property
    def is_batchable(self) -> bool:
        """Whether episodes may be one record while they answer it."""
        trees = [parse(f"{term.text};") for term in self.terms]
        return not any(_tells_episodes_apart(node) for tree in trees for node in tree.statements)

    @property
    def reads_present(self) -> bool:
        """Whether it reads more of the last tick than its time."""
        return False  # it goes to the ticks that it reads

    def answering(self, interpreter: Interpreter) -> Answering:  # noqa: ARG002
        """Returns a function that answers about episodes, whose judges it keeps."""
        judges: dict[Any, Judge] = {}

        def answer(present: Interpreter, entry: EpisodeEntry) -> dict[str, Any]:
            steps = EpisodeSteps.read(expand_path(entry.path), entry.world, entry.episode)
            score = score_with(present, entry.world, entry.episode, steps, self.terms, judges)
            return self._told(score)

        return answer

    def _told(self, score: EpisodeScore) -> dict[str, Any]:
        """Returns what the answer has of a score."""
        return {
            "return": score.total,
            "success": score.succeeded,
            "failure": None if score.failure is None else any(score.failure[-1:]),  # the last
            "steps": len(score.rewards),
            "seed": score.seed,
        }


class StepsQuestion(ScoreQuestion):
    """The terms of a task; the answer has the whole score, with the values after each step."""

    @property
    def key(self) -> str:
        """What tells it from other questions."""
        return f"steps {super().key}"

    def _told(self, score: EpisodeScore) -> dict[str, Any]:
        return {field.name: getattr(score, field.name) for field in fields(score)}


# What each episode answers by itself.
Question: TypeAlias = ProgramQuestion | ScoreQuestion


def plain(value: Any) -> Any:
    """Returns an answer as None, True, False, numbers, texts, and lists and dicts of such.

    Entities and links become their full names.
    """
    match value:
        case None | bool() | int() | float() | str():
            return value
        case np.generic() | np.ndarray():
            return plain(value.tolist())
        case Handle():
            return value.full_name
        case RowsOfColumns():
            columns = value.columns
            return [dict(zip(columns, map(plain, row), strict=True)) for row in value]
        case list() | tuple():
            return [plain(element) for element in value]
        case Mapping():
            return {str(plain(key)): plain(element) for key, element in value.items()}
    if hasattr(value, "columns"):  # of pandas, Polars or Arrow
        raise ArgumentError(
            f"the answer is a {type(value).__name__}: leave its AS … out; ask(…).to_pandas() is a "
            "frame of the rows of all episodes"
        )
    if isinstance(value, World):
        raise ArgumentError(
            f"the answer is the world {value.name}: ask for its entities by a query, or for what "
            f"holds of one, as in z({value.name}.cup)"
        )
    raise ArgumentError(
        f"the answer is {short_repr(value)}: ask for numbers, texts, lists or records"
    )
