"""The terms of a task: conditions and numbers in SelectScript, with at most a statement a step."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias
from typing import Literal as OneOf

from ssduck import validation
from ssduck.errors import ArgumentError, SelectScriptError, UnknownNameError
from ssduck.formatting import joined_names, short_repr
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.program import CompiledProgram
from ssduck.interpreter.temporal_functions import TEMPORAL_FUNCTIONS
from ssduck.language.tree import (
    Call,
    Index,
    Literal,
    Name,
    Node,
    QualifiedName,
    Query,
    TimeIndex,
)
from ssduck.schema import RECORDABLE, RECORDED_BY_DEFAULT
from ssduck.sql.table_use import tables_of
from ssduck.world.world import World

# A reward: one term, or several by name, which are added.
Reward: TypeAlias = str | Mapping[str, str]
# What terms are where they cannot be computed, since a number of the state is NaN: an error, a
# failed episode, or this value (and False for a condition).
WhereNaN: TypeAlias = OneOf["error", "failure"] | float
# The terms that others can use by their names.
CONDITIONS = ("success", "failure")
# The name of a reward that is one term.
WHOLE = "reward"


@dataclass(frozen=True)
class Term:
    """An expression of SelectScript.

    Attributes:
        key: the argument that has it, such as `success` or `reward['height']`.
        text: the expression.
        is_condition: whether its value is True or False; else it is a number.
    """

    key: str
    text: str
    is_condition: bool

    def check(self, value: Any) -> Any:
        """Returns the value of the term.

        Raises:
            ArgumentError: it is of the wrong type.
        """
        if self.is_condition and isinstance(value, bool):
            return value
        if not self.is_condition and validation.is_number(value):
            return self._number(value)
        if value is None:
            hint = "an entity, a joint or a past that it names is not there at this step"
        elif self.is_condition:
            hint = "compare it with something, as in z(sim.cup) > 0.5"
        elif isinstance(value, bool):
            hint = "int(…) makes 1 of True and 0 of False"
        else:
            hint = "a reward or an observation is one"
        expected = "True or False" if self.is_condition else "a number"
        raise ArgumentError(
            f"{self.key}: {self.text!r} is {short_repr(value)}, not {expected}: {hint}"
        )

    def nan_error(self, sources: str) -> ArgumentError:
        """Returns the error of a term that cannot be computed, since numbers are NaN."""
        return ArgumentError(
            f"{self.key}: {self.text!r} is NaN (not a number): {sources}. nan='failure' makes this "
            "a failure of the episode, and nan=-1.0 gives the term that value"
        )

    def _number(self, value: Any) -> float:
        """Returns a number as a float.

        Raises:
            ArgumentError: it is an integer beyond all floats.
        """
        try:
            return float(value)
        except OverflowError:
            raise ArgumentError(
                f"{self.key}: {self.text!r} is {short_repr(value)}, and a reward or an observation "
                "is a float, at most 1.8e308"
            ) from None


@dataclass(frozen=True)
class Judgement:
    """The values of the terms at a step.

    Attributes:
        success: whether the task is done; None without such a term.
        failure: whether it has failed; None without such a term.
        stop: whether the episode ends; None without such a term.
        reward: the sum of the parts; None without a reward.
        parts: the parts of the reward by name.
    """

    success: bool | None
    failure: bool | None
    stop: bool | None
    reward: float | None
    parts: Mapping[str, float]


@dataclass(frozen=True)
class Terms:
    """The terms of a task.

    Attributes:
        success: whether the task is done.
        failure: whether it has failed.
        stop_when: whether the episode ends.
        parts: the parts of the reward by name.
        nan: what terms are that depend on NaN.
    """

    success: Term | None
    failure: Term | None
    stop_when: Term | None
    parts: Mapping[str, Term]
    nan: WhereNaN = "error"

    @classmethod
    def of(
        cls,
        success: str | None,
        failure: str | None,
        reward: Reward | None,
        stop_when: str | None,
        *,
        table: str = WHOLE,
        nan: WhereNaN = "error",
    ) -> Terms:
        """Returns the terms that texts describe.

        Args:
            success: whether the task is done.
            failure: whether it has failed.
            reward: the reward, or its parts by name.
            stop_when: whether the episode ends.
            table: the argument that has the parts, for messages.
            nan: what terms are that depend on NaN.

        Raises:
            ArgumentError: a term is no text, or there is none, or `nan` is something else.
        """
        is_finite = not isinstance(nan, str) and validation.is_number(nan) and math.isfinite(nan)
        if not (is_finite or nan in ("error", "failure")):
            raise ArgumentError(f"nan: give 'error', 'failure' or a number, not {short_repr(nan)}")
        rewards: Mapping[Any, Any] = (
            {} if reward is None else (reward if isinstance(reward, Mapping) else {WHOLE: reward})
        )
        keys = {name: WHOLE if name == WHOLE else f"{table}[{name!r}]" for name in rewards}
        conditions = {"success": success, "failure": failure, "stop_when": stop_when}
        if not rewards and all(text is None for text in conditions.values()):
            raise ArgumentError("give a term: success, failure, reward or stop_when")
        for key, text in (*conditions.items(), *((keys[name], rewards[name]) for name in rewards)):
            if text is not None and not (isinstance(text, str) and text.strip(" \n\t;")):
                raise ArgumentError(
                    f"{key}: a term is a text of SelectScript, not {short_repr(text)}"
                )
        texts = {key: _stripped(text) for key, text in conditions.items() if text is not None}
        terms = {key: Term(key, text, is_condition=True) for key, text in texts.items()}
        return cls(
            terms.get("success"),
            terms.get("failure"),
            terms.get("stop_when"),
            {
                str(name): Term(keys[name], _stripped(text), is_condition=False)
                for name, text in rewards.items()
            },
            nan if isinstance(nan, str) else float(nan),
        )

    def __iter__(self) -> Iterator[Term]:
        for term in (self.success, self.failure, self.stop_when):
            if term is not None:
                yield term
        yield from self.parts.values()

    @property
    def texts(self) -> dict[str, Any]:
        """The texts of the terms, as they are stored with an episode."""
        conditions = {
            name: None if term is None else term.text
            for name, term in (
                ("success", self.success),
                ("failure", self.failure),
                ("stop_when", self.stop_when),
            )
        }
        rewards = {name: term.text for name, term in self.parts.items()}
        where_nan = {} if self.nan == "error" else {"nan": self.nan}
        return conditions | {"reward": rewards} | where_nan

    def judgement_of_nan(self, values: Sequence[Any], sources: str) -> Judgement:
        """Returns what values mean of which some could not be computed, since numbers are NaN.

        Args:
            values: the values of all terms, in their order.
            sources: what is NaN.

        Raises:
            ArgumentError: this is an error, or a value is of the wrong type.
        """
        number = self.nan if isinstance(self.nan, float) else 0.0
        replaced = []
        for term, value in zip(self, values, strict=True):
            if not _is_nan(value):
                replaced.append(value)
            elif self.nan == "error":
                raise term.nan_error(sources)
            else:
                replaced.append(False if term.is_condition else number)
        judgement = self.judgement(replaced)
        if self.nan != "failure":
            return judgement
        success = None if self.success is None else False
        return replace(judgement, success=success, failure=True, stop=True)

    def judgement(self, values: Sequence[Any]) -> Judgement:
        """Returns what the values of all terms, in their order, mean.

        Raises:
            ArgumentError: a value is of the wrong type.
        """
        left = iter(values)
        success, failure, stop = (
            None if term is None else term.check(next(left))
            for term in (self.success, self.failure, self.stop_when)
        )
        parts = {
            name: term.check(value)
            for (name, term), value in zip(self.parts.items(), left, strict=True)
        }
        return Judgement(success, failure, stop, sum(parts.values()) if parts else None, parts)


class Judge:
    """Evaluates the terms of a task at the present tick of a world, with one statement at most.

    Args:
        terms: the terms.
        interpreter: runs them; it has the world.
        world: the name of the world.
        variables: the names of the variables that are set at each step.
        if_unknown: what to do about a name that no variable has, with {name} for it.

    Attributes:
        terms: the terms.
        past_tables: the tables to be recorded for terms that read the past; none if none does.
    """

    def __init__(
        self,
        terms: Terms,
        interpreter: Interpreter,
        world: str,
        variables: Sequence[str],
        *,
        if_unknown: str,
    ) -> None:
        _check_variables(variables, terms, world)
        self._if_unknown = if_unknown
        self.terms = terms
        self._interpreter, self._world = interpreter, world
        self._elements: dict[str, set[int]] = {name: set() for name in variables}
        self._whole: set[str] = set()
        # The last values of variables and elements.
        self._bound: dict[str, Any] = {}
        for name in variables:  # so that errors suggest them
            interpreter.add_variable(name, None)
        self._texts = [self._expanded(term) for term in terms]
        # Each was compiled by itself, so that none is more than an expression.
        self._program = interpreter.compile(_selected(self._texts))
        trees = [self._tree(term.text) for term in terms]
        self.past_tables: frozenset[str] = frozenset()
        if any(map(_is_temporal, trees)):
            read = frozenset().union(*map(tables_of, trees)).intersection(RECORDABLE)
            self.past_tables = read.union(RECORDED_BY_DEFAULT)

    def set_variables(self, values: Mapping[str, Any]) -> None:
        """Sets the variables.

        Raises:
            ArgumentError: a list is too short.
        """
        for name, value in values.items():
            for index in self._elements[name]:
                try:
                    element = value[index]
                except (TypeError, IndexError, KeyError):
                    raise ArgumentError(
                        f"variables[{name!r}]: a term uses {name}[{index}], and the value is "
                        f"{short_repr(value)}"
                    ) from None
                self._bind(self._element(name, index), element)
            if name in self._whole:
                self._bind(name, value)

    def _bind(self, name: str, value: Any) -> None:
        """Sets a variable unless it has the value already: what reads it need not be found anew."""
        bound = self._bound.get(name)
        if not (is_same(bound, value) and self._interpreter[name] is bound):
            self._bound[name] = self._interpreter.add_variable(name, value)

    def _element(self, name: str, index: int) -> str:
        """Returns the name of an element of a list that a variable has, which none else has."""
        element = f"{name}__{index}"
        while element in self._elements:
            element += "_"
        return element

    def judgement(self) -> Judgement:
        """Returns the values of the terms at the present tick.

        Raises:
            SelectScriptError: a term failed, or its value is of the wrong type.
        """
        try:
            values = self._interpreter.eval(self._program)
        except ArgumentError:
            if not self._nan_sources():
                raise
            values = [self._value_or_nan(text) for text in self._texts]
        if any(map(_is_nan, values)) and (sources := self._nan_sources(values)):
            return self.terms.judgement_of_nan(values, sources)
        return self.terms.judgement(values)

    def _value_or_nan(self, text: str) -> Any:
        """Returns the value of a term; None if it fails, as it does where a number is NaN."""
        try:
            return self._interpreter.eval(_selected([text]))[0]
        except ArgumentError:
            return None

    def _nan_sources(self, values: Sequence[Any] = ()) -> str:
        """Returns what is NaN at the present tick, of which terms may depend; '' if nothing is.

        Args:
            values: the values of the terms.
        """
        world = self._interpreter[self._world]
        assert isinstance(world, World)
        names = [f"{self._world}.{entity.name}" for entity in world.snapshot.entities_with_nan()]
        sources = [f"the pose or the velocity of {joined_names(names)} is"] if names else []
        variables = [name for name, value in self._bound.items() if _has_nan(value)]
        sources += [f"the variable {name} has" for name in variables]
        if not sources and any(map(_has_nan, values)):
            return "what it computes is no number"
        return " NaN, and ".join(sources) + " NaN at this step" if sources else ""

    def check(self, *, may_be_constant: bool = False, with_variables: bool = True) -> None:
        """Checks each term by itself at the present tick.

        Args:
            may_be_constant: whether a term may be one that can never change.
            with_variables: whether terms that use variables are checked, too.

        Raises:
            SelectScriptError: a term fails, can never change, or is of the wrong type; the message
                begins with its key.
        """
        for term, text in zip(self.terms, self._texts, strict=True):
            program = self._compiled(term.key, text)
            if not with_variables and self._uses_variables(program):
                continue
            try:
                value = self._value(term, program)
                # Python skips what an AND or OR does not need; a plan knows all names.
                self._value(term, _selected([text]))
                term.check(value)
            except ArgumentError:
                if not (sources := self._nan_sources()):
                    raise
                if self.terms.nan == "error":
                    raise term.nan_error(sources) from None
            if not may_be_constant:
                self._check_changes(term, program)

    def _value(self, term: Term, program: str | CompiledProgram) -> Any:
        """Returns the value of a program for a term, whose key begins the message of an error."""
        try:
            return self._interpreter.eval(program)
        except SelectScriptError as error:
            error.message = f"{term.key}: {error.message}{self._what_to_do(error, program)}"
            raise

    def _what_to_do(self, error: SelectScriptError, program: str | CompiledProgram) -> str:
        """Returns what to do about a name that no variable has, and that is like none; else ''."""
        if isinstance(program, str) or not isinstance(error, UnknownNameError):
            return ""
        world = self._interpreter[self._world]
        for node in program.tree.statements[0].walk():
            if isinstance(node, Name) and node.span == error.span:
                is_entity = isinstance(world, World) and node.name in world
                is_hinted = is_entity or error.suggestions or node.name in self._interpreter
                return "" if is_hinted else f"; {self._if_unknown.format(name=node.name)}"
        return ""

    def _compiled(self, key: str, text: str) -> CompiledProgram:
        try:
            program = self._interpreter.compile(f"{text};")
        except SelectScriptError as error:
            error.message = f"{key}: {error.message}"
            raise
        if len(program.tree.statements) != 1 or program.tree.explain:
            raise ArgumentError(f"{key}: {text!r} is to be one expression")
        for doubt in program.tree.suspicions:
            if doubt.is_grave:
                raise ArgumentError(
                    f"{key}: {doubt.message}", text=program.tree.text, span=doubt.span
                )
        return program

    def _tree(self, text: str) -> Node:
        return self._compiled("term", text).tree.statements[0]

    def _expanded(self, term: Term) -> str:
        """Returns the text of a term with the conditions that it names, and elements of lists.

        A list that changes at each step would have to be planned at each step; numbers are not.
        """
        text, known = term.text, self.terms
        replacements: list[tuple[int, int, str]] = []

        def visit(node: Node) -> Node | None:
            match node:
                case Index(base=Name(name=name), indices=(Literal(value=int() as index),)) if (
                    name in self._elements and index >= 0 and not isinstance(index, bool)
                ):
                    self._elements[name].add(index)
                    replacement = self._element(name, index)
                case Name(name=name) if name in self._elements:
                    self._whole.add(name)
                    return node
                case Name(name=name) if name in CONDITIONS and name != term.key:
                    condition = getattr(known, name)
                    if condition is None:
                        raise ArgumentError(f"{term.key} uses {name}, and there is no such term")
                    if term.key in CONDITIONS:
                        raise ArgumentError(f"{term.key} cannot use {name}: write its term out")
                    replacement = f"({self._expanded(condition)}\n)"
                case _:
                    return None
            replacements.append((node.span.start, node.span.end, replacement))
            return node

        self._compiled(term.key, text).tree.statements[0].replaced(visit)
        for start, end, replacement in sorted(replacements, reverse=True):
            text = text[:start] + replacement + text[end:]
        return text

    def _uses_variables(self, program: CompiledProgram) -> bool:
        """Checks whether a program uses variables that are set at each step."""
        variables = {*self._elements} | {
            self._element(name, index)
            for name, indices in self._elements.items()
            for index in indices
        }
        nodes = program.tree.statements[0].walk()
        return any(isinstance(node, Name) and node.name in variables for node in nodes)

    def _check_changes(self, term: Term, program: CompiledProgram) -> None:
        """Checks that the value of a term may differ from step to step.

        Raises:
            ArgumentError: it cannot.
        """
        names: set[str] = set()
        is_open = False
        entities: set[str] = set()

        def visit(node: Node) -> Node | None:
            nonlocal is_open
            match node:
                case Index(base=Name(name=self._world), indices=(Literal(value=str() as name),)):
                    entities.add(name)
                    return node
                case QualifiedName(alias=self._world, key=name):
                    entities.add(name)
                case Name(name=name) | TimeIndex(name=name):
                    names.add(name)
                case Query():
                    is_open = True
            return None

        program.tree.statements[0].replaced(visit)
        if is_open or self._world in names or self._uses_variables(program):
            return
        if not entities:
            raise ArgumentError(
                f"{term.key}: {term.text!r} can never change: it has no entity of {self._world!r}, "
                f"such as {self._world}.cup, and no variable"
            )
        world = self._interpreter[self._world]
        assert isinstance(world, World)
        bodies = {entity.name: entity.body for entity in world.snapshot.entities}
        known = [bodies.get(name) for name in sorted(entities)]
        if all(body is not None and not body.movable for body in known):
            raise ArgumentError(
                f"{term.key}: {term.text!r} can never change: no joint moves "
                f"{' or '.join(sorted(entities))}; if a reset moves it, give its place as a "
                "variable: variables={'place': lambda env: …}"
            )


def _check_variables(names: Sequence[str], terms: Terms, world: str) -> None:
    """Checks that no variable takes the place of the world, or of a term that others may name.

    Raises:
        ArgumentError: one does.
    """
    for name in names:
        if name == world:
            raise ArgumentError(f"variables: {name!r} is the name of the world")
        if name in CONDITIONS and getattr(terms, name) is not None:
            raise ArgumentError(
                f"variables: {name!r} is the name of a term: give the variable another name"
            )


def _selected(texts: Iterable[str]) -> str:
    """Returns the program whose value is the list of the values of expressions."""
    columns = ", ".join(f"({text}\n)" for text in texts)  # a comment ends with its line
    return f"SELECT {columns} FROM [0] AS list;"  # noqa: S608


def is_same(a: Any, b: Any) -> bool:
    """Checks whether two values are the same numbers, texts or lists of these, to the last bit.

    >>> is_same([1.0, 0.0], [1.0, 0.0]), is_same(1.0, 1), is_same(0.0, -0.0)
    (True, False, False)
    """
    if type(a) is not type(b):
        return False
    if isinstance(a, list):
        return len(a) == len(b) and all(map(is_same, a, b))
    is_equal = isinstance(a, bool | int | float | str) and a == b
    return is_equal and (a != 0 or repr(a) == repr(b))  # a zero has a sign


def _is_nan(value: Any) -> bool:
    """Checks whether the value of a term is NaN; a column that depends on NaN is NULL."""
    return value is None or (isinstance(value, float) and math.isnan(value))


def _has_nan(value: Any) -> bool:
    """Checks whether the value of a variable is NaN, or a list that has it."""
    if isinstance(value, list):
        return any(map(_has_nan, value))
    return isinstance(value, float) and math.isnan(value)


def _stripped(text: str) -> str:
    return text.strip().removesuffix(";").rstrip()


def _is_temporal(node: Node) -> bool:
    """Checks whether an expression reads the past."""
    return any(
        isinstance(part, TimeIndex) or (isinstance(part, Call) and part.name in TEMPORAL_FUNCTIONS)
        for part in node.walk()
    )
