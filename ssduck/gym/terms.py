"""The terms of a task: conditions and numbers in SelectScript."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias
from typing import Literal as OneOf

from ssduck import validation
from ssduck.errors import ArgumentError, SelectScriptError
from ssduck.formatting import short_repr

if TYPE_CHECKING:
    from ssduck.interpreter.interpreter import Interpreter
    from ssduck.interpreter.program import CompiledProgram

# A reward: one term, or several by name, which are added.
Reward: TypeAlias = str | Mapping[str, str]
# What terms are where they cannot be computed, since a number of the state is NaN: an error, a
# failed episode, or this value (and False for a condition).
WhereNaN: TypeAlias = OneOf["error", "failure"] | float
# The terms that others can use by their names.
CONDITIONS = ("success", "failure")
_LOOKING_AHEAD = re.compile(r"\b(always|eventually|until)\s*\(")
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
        """Returns the value of the term."""
        if self.is_condition and isinstance(value, bool):
            return value
        if not self.is_condition and validation.is_number(value):
            return self._number(value)
        if value is None and (ahead := _LOOKING_AHEAD.search(self.text)):
            hint = f"{ahead[1]} may depend on later steps; once, historically and heldSince do not"
        elif value is None:
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
        computed: the values of all terms in their order; None of one that is NaN.
    """

    success: bool | None
    failure: bool | None
    stop: bool | None
    reward: float | None
    parts: Mapping[str, float]
    computed: Sequence[bool | float | None]


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
        """Returns the terms that texts describe."""
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
                shown = short_repr(text)
                quoted = f": write '{shown}'" if validation.is_number(text) else ""
                raise ArgumentError(f"{key}: a term is a text of SelectScript, not {shown}{quoted}")
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

    @property
    def conditions(self) -> dict[str, Term | None]:
        """The terms that are conditions, by name; None for one that there is not."""
        return {"success": self.success, "failure": self.failure, "stop_when": self.stop_when}

    def __iter__(self) -> Iterator[Term]:
        yield from (term for term in self.conditions.values() if term is not None)
        yield from self.parts.values()

    @property
    def texts(self) -> dict[str, Any]:
        """The texts of the terms, as they are stored with an episode."""
        conditions = {n: term and term.text for n, term in self.conditions.items()}
        rewards = {name: term.text for name, term in self.parts.items()}
        where_nan = {} if self.nan == "error" else {"nan": self.nan}
        return conditions | {"reward": rewards} | where_nan

    def judgement_of_nan(self, values: Sequence[Any], sources: str) -> Judgement:
        """Returns what values mean of which some could not be computed, since numbers are NaN."""
        number = self.nan if isinstance(self.nan, float) else 0.0
        replaced = []
        for term, value in zip(self, values, strict=True):
            if not is_nan(value):
                replaced.append(value)
            elif self.nan == "error":
                raise term.nan_error(sources)
            else:
                replaced.append(False if term.is_condition else number)
        computed = [None if is_nan(value) else value for value in values]
        judgement = replace(self.judgement(replaced), computed=computed)
        if self.nan != "failure":
            return judgement
        success = None if self.success is None else False
        return replace(judgement, success=success, failure=True, stop=True)

    def judgement(self, values: Sequence[Any]) -> Judgement:
        """Returns what the values of all terms, in their order, mean."""
        computed = [term.check(value) for term, value in zip(self, values, strict=True)]
        left = iter(computed)
        success, failure, stop = (
            None if term is None else next(left) for term in self.conditions.values()
        )
        parts = dict(zip(self.parts, left, strict=True))
        reward = sum(parts.values()) if parts else None
        return Judgement(success, failure, stop, reward, parts, computed)


def compiled(interpreter: Interpreter, key: str, text: str) -> CompiledProgram:
    """Returns the program of a term, which is one expression; errors begin with its key."""
    try:
        program = interpreter.compile(f"{text};")
    except SelectScriptError as error:
        error.message = f"{key}: {error.message}"
        raise
    if len(program.tree.statements) != 1 or program.tree.explain:
        hint = f", without {program.tree.explain}" if program.tree.explain else ""
        raise ArgumentError(f"{key}: {text!r} is to be one expression{hint}")
    for doubt in program.tree.suspicions:
        if doubt.is_grave:
            raise ArgumentError(f"{key}: {doubt.message}", text=program.tree.text, span=doubt.span)
    return program


def is_nan(value: Any) -> bool:
    """Checks whether the value of a term is NaN; a column that depends on NaN is NULL."""
    return value is None or (isinstance(value, float) and math.isnan(value))


def _stripped(text: str) -> str:
    return text.strip().removesuffix(";").rstrip()
