"""The variables and functions of an interpreter, by name."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from inspect import unwrap
from types import MappingProxyType
from typing import Any

from ssduck import validation
from ssduck.adapters.registry import all_adapters, tables_read_by
from ssduck.database.database import Database
from ssduck.errors import ArgumentError, LimitError, UnknownNameError, nearest, warn
from ssduck.formatting import name_path, short_repr
from ssduck.interpreter.link_functions import LINK_FUNCTIONS, mentions_links
from ssduck.interpreter.output import (
    HELP_OF_WORDS,
    help_of_result_form,
    help_of_result_forms,
)
from ssduck.interpreter.over_time.expansions import EXPANSIONS
from ssduck.interpreter.over_time.functions import TEMPORAL_FUNCTIONS
from ssduck.interpreter.sources import worlds_in
from ssduck.language import ast
from ssduck.language.analysis import (
    BINARY_SIGNS,
    NOT_OVERRIDABLE,
    OF_MARGINS,
    OPERATOR_NAMES,
    UNARY_SIGNS,
    calls_of,
    forms_of,
    marked_name,
    variables_of,
    written_name,
)
from ssduck.language.builtins import AGGREGATES, BUILTINS, EXTREMES, Function
from ssduck.language.evaluation_errors import unknown_function
from ssduck.language.intervals import RELATIONS_OF_INTERVALS
from ssduck.language.operators import check_size
from ssduck.language.parser import is_reserved
from ssduck.language.sql_suggestions import suggestion_for_name
from ssduck.language.value_history import (
    LazyList,
    ValueHistory,
    history_of,
    past_value,
    with_assignment,
)
from ssduck.language.value_keys import python_value
from ssduck.limits import Limits
from ssduck.recording.replay.past import Past, past_of
from ssduck.sql.name_resolution import SCALARS
from ssduck.sql.relation_calls import tables_of
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.relations.relation import Relation
from ssduck.world.handles import Links
from ssduck.world.world import World

# The least similarity of a function's name that is suggested for an unknown variable.
_FUNCTION_LIKENESS = 0.8
# What to write for a call with another number of arguments.
_CALLS = {
    "heldFor": "the time is compared: heldFor(condition) >= 0.2",
    "since": "how long a condition has held is compared: heldFor(condition) >= 0.2; of two "
    "conditions write heldSince(condition, start)",
    "heldSince": "heldSince(condition, start[, from, to]); since when a condition has held is "
    "since(condition), and for how long heldFor(condition)",
    "time": "the simulated time now is getTime(), that of a row time(this)",
    **{name: f"of several values, it is {name}([a, b])" for name in AGGREGATES},
    **{name: f"of several values, it is {list_one}([a, b])" for name, list_one in EXTREMES.items()},
}
_PAIR = "{1}; of anything in a world: EXISTS (SELECT this FROM room WHERE {0}(cup, this))"
# Messages name at most this number of worlds.
_MAX_WORLDS = 5


class Variables(dict[str, Any]):
    """Variables by name."""

    def __init__(self, values: Mapping[str, Any] = MappingProxyType({})) -> None:
        super().__init__(values)
        self.version = object()  # an object that is replaced whenever a value is bound to a name

    def __setitem__(self, name: str, value: Any) -> None:
        self.version = object()
        super().__setitem__(name, value)


class Namespace:
    """The variables and functions of an interpreter, and its worlds."""

    def __init__(self, database: Database, limits: Limits) -> None:
        self.database = database
        self.limits = limits
        # The variables that programs have set.
        self._assigned: set[str] = set()
        self.lock = threading.RLock()
        self._variables = Variables()
        self.functions: dict[str, Function] = dict(BUILTINS)
        # The language's own functions that users' functions override, by name.
        self.overrides: dict[str, Function | None] = {}
        self.functions.update((command.name, command) for command in self._commands())
        self.functions.update(LINK_FUNCTIONS)
        for form in TEMPORAL_FUNCTIONS.values():
            if not form.of_margins:  # which robustness makes, and nobody writes
                self.functions[form.name] = form.function
        self.functions.update((name, form.function) for name, form in EXPANSIONS.items())
        for name, allen in RELATIONS_OF_INTERVALS.items():
            if name not in RELATIONS:
                self.functions[name] = allen.function

    # -- variables (ssduck.language.evaluator.EvaluationScope) -------------------------------

    @property
    def variables(self) -> Variables:
        """The values and histories of the variables, by name."""
        return self._variables

    @variables.setter
    def variables(self, values: Mapping[str, Any]) -> None:
        self._variables = values if isinstance(values, Variables) else Variables(values)

    def variable(self, name: str) -> Any:
        """Returns the value of a variable."""
        if type(name) is not str:  # programs read variables at each step
            validation.text(name, "the name of a variable is a text")
        variables = self._variables
        if name in variables:
            value = variables[name]
            return value.last if isinstance(value, ValueHistory) else value
        if name in RELATIONS or name in self.functions:
            told = f"; {_CALLS[name]}" if name in RELATIONS and name in _CALLS else ""
            raise UnknownNameError(
                f"there is no variable {name!r}; {name} is a function: write {self._call(name)}, "
                f"say{told}"
            )
        raise self._unknown_variable(name)

    def _call(self, name: str) -> str:
        """Returns a call of a function of the rows of a query, as an example."""
        relation = RELATIONS.get(name)
        if relation is None or relation.required_count == 1:
            return f"{name}(this)"
        if [part.type for part in relation.parameters[: relation.required_count]] == ["entity"] * 2:
            names = ((w.name, e.name) for w in self.worlds for e in w.snapshot.entities)
            return f"{name}({name_path(*next(names, ('room', 'cup')))}, this)"
        return relation.usage.partition(" -> ")[0]

    def _unknown_variable(self, name: str) -> UnknownNameError:
        """Returns the error for an unknown variable; it says what the name may stand for."""
        message = f"there is no variable {short_repr(name)}"
        worlds = {key: value for key, value in self.variables.items() if isinstance(value, World)}
        owners = [key for key, world in worlds.items() if name in world]
        if owners and name.isidentifier():
            choices = " or ".join(f"{key}.{name}" for key in owners[:_MAX_WORLDS])
            return UnknownNameError(f"{message}; for the entity, write {choices}")
        hints = filter(None, (world.part_hint(name) for world in worlds.values()))
        if instead := next(hints, "") or suggestion_for_name(name):
            return UnknownNameError(f"{message}; {instead}")
        functions = (known for known in self.names() if known not in self.variables)
        near = nearest(name, self.variables) or nearest(name, functions, least=_FUNCTION_LIKENESS)
        if worlds and not near:
            names = ", ".join(map(repr, [*worlds][:_MAX_WORLDS]))
            message += f"; the world is {names}" if len(worlds) == 1 else f"; worlds are {names}"
        return UnknownNameError(message, suggestions=near)

    def has_variable(self, name: str) -> bool:
        """Checks whether a variable has that name."""
        return name in self._variables

    def is_function(self, name: str) -> bool:
        """Checks whether a function or a relation has that name."""
        return name in RELATIONS or name in self.functions

    def is_scalar(self, name: str) -> bool:
        """Checks whether that is a relation whose value is a number, a text, True or False."""
        return self.type_of_relation(name) in SCALARS

    def type_of_relation(self, name: str) -> str | None:
        """Returns the type of a relation's result; None if a name is no relation."""
        is_relation = name in RELATIONS and not self.is_users(name)
        return RELATIONS[name].result if is_relation else None

    def is_world(self, name: str) -> bool:
        """Checks whether a variable is a world, its past or its links."""
        return isinstance(self.variables.get(name), World | Past | Links)

    def is_world_without(self, name: str, entity: str) -> bool:
        """Checks whether a variable is a world that has no entity of a name."""
        value = self.variables.get(name)
        return isinstance(value, World) and entity not in value

    def bound_values(self, names: Iterable[str]) -> tuple[Any, ...]:
        """Returns what is bound to names: values, histories of values, or None."""
        return tuple(map(self._variables.get, names))

    def variable_or_none(self, name: str) -> Any:
        """Returns the value of a variable; None if there is none."""
        return self.variable(name) if self.has_variable(name) else None

    def names(self) -> list[str]:
        """Returns the names of all variables and functions."""
        return [*self.variables, *self.known_functions()]

    def assign(self, name: str, value: Any) -> None:
        """Sets a variable."""
        self._check_may_replace(name)
        self.variables[name] = value
        self._assigned.add(name)

    def bind(self, name: str, value: Any) -> None:
        """Sets a variable of the user's."""
        self.variables[name] = value
        self._assigned.discard(name)

    @contextmanager
    def with_parameters(self, parameters: Mapping[str, Any]) -> Iterator[None]:
        """Binds values to names in a context, after which the variables are as before."""
        with self.lock:
            before = {name: self.variables[name] for name in parameters if name in self.variables}
            for name, value in parameters.items():
                check_name(name, "a parameter")
                if isinstance(value, World) or isinstance(before.get(name), World):
                    raise ArgumentError(
                        f"eval: the parameter {name!r} would bind or hide a world: bind worlds "
                        "with add_variable, and give parameters other names"
                    )
            try:
                for name, value in parameters.items():
                    self.bind(name, python_value(value))
                yield
            finally:
                for name in parameters:
                    self.variables.pop(name, None)
                for name, value in before.items():
                    self.bind(name, value)

    def keep(self, name: str, value: Any, horizon: float) -> None:
        """Sets a variable that keeps its values for a time in seconds."""
        before, now = self.variables.get(name), self._now()
        if isinstance(value, World):
            raise ArgumentError("a world cannot be kept in a history; assign it without {…}")
        self._check_may_replace(name)
        self.variables[name] = with_assignment(before, value, horizon, now)
        self._assigned.add(name)

    def release_worlds(self) -> None:
        """Forgets the worlds that programs have bound: each is closed if nothing else has it."""
        for name in self._assigned:
            if isinstance(self.variables.get(name), World):
                self.variables.pop(name)

    def _check_may_replace(self, name: str) -> None:
        """Checks that a program of a stranger leaves a world of the user's as it is."""
        if self.limits.select_only and name not in self._assigned and self.is_world(name):
            raise LimitError(f"{name} is a world, which programs cannot replace here")

    def past_value(self, name: str, *age: Any) -> Any:
        """Returns the past value of a variable; all kept values if no age is given."""
        self.variable(name)
        value = self.variables[name]
        if isinstance(value, World):
            seconds = validation.seconds(age[0], "what is in {…}") if age else None
            record = self.database.record_of(value)
            record.warn_of_dropped_ticks(seconds)
            return past_of(record, seconds)
        return past_value(name, value, age, self._now)

    def history(self, name: str) -> list[tuple[float, Any]]:
        """Returns the values of a variable with a history, and their times.

        Args:
            name: the name of a variable that was assigned by `name{5.0} = …` or `name{} = …`.

        Returns:
            The simulated time of each assignment, s, and its value, the oldest first.

        Raises:
            UnknownNameError: no variable has that name; the error suggests the nearest names.
            ArgumentError: the variable has no history.
        """
        with self.lock:
            self.variable(name)
            return history_of(name, self.variables[name]).within(math.inf, self._now())

    def _now(self) -> float:
        """Returns the simulated time of the first world, s."""
        worlds = self.database.worlds.values()
        for world in worlds:
            return world.time
        raise UnknownNameError("there is no world, so no simulated time; add one with add_variable")

    def expire_histories(self) -> None:
        """Drops values that are older than their horizon, or later than now."""
        temporal = [(n, v) for n, v in self.variables.items() if isinstance(v, ValueHistory)]
        if temporal:
            now = self._now()
            for name, history in temporal:
                self.variables[name] = history.until(now).recent(now)

    # -- functions ---------------------------------------------------------------------------

    def function(self, name: str) -> Function | None:
        """Returns a function that is no relation; the language's own if the name is not marked."""
        if name in self.overrides:
            return self.overrides[name]
        return self.functions.get(written_name(name))

    def resolved_name(self, name: str) -> str:
        """Returns the name that calls a function: the user's function, if it overrides another."""
        return marked_name(name) if name in self.overrides else name

    def add_function(self, function: Function) -> None:
        """Adds a user's function; warns if it overrides a part of the language."""
        name = function.name
        known = self.functions.get(name)
        if name in NOT_OVERRIDABLE:
            raise ArgumentError(f"{name!r} is a part of the language; choose another name")
        is_users = known is not None and not known.builtin
        if is_users or not (name in RELATIONS or name in OPERATOR_NAMES or known is not None):
            self.functions[name] = function
            return
        if known is not None and unwrap(known.call) is function.call:
            return  # `addFunction('str', str)` of the published programs
        self.overrides[name] = known
        self.functions[name] = function
        sign = BINARY_SIGNS.get(name) or UNARY_SIGNS.get(name)
        part = f"the operator {sign}" if sign else f"the language's own {name}"
        sql_note = "; raw SQL keeps its own" if name in RELATIONS else ""
        warn(
            f"your function {name!r} replaces {part} in programs{sql_note}; "
            f"del_function({name!r}) restores it"
        )

    def remove_function(self, name: str) -> None:
        """Removes a user's function; the one that it overrode is back."""
        is_name = isinstance(name, str) and name == written_name(name)
        if not is_name or not self.is_users(self.resolved_name(name)):
            raise UnknownNameError(
                f"there is no function {short_repr(name)} of yours",
                suggestions=nearest(name, self.users_functions()),
            )
        before = self.overrides.pop(name, None)
        if before is None:
            del self.functions[name]
        else:
            self.functions[name] = before

    def users_functions(self) -> list[str]:
        """Returns the names of the users' functions."""
        return [name for name, function in self.functions.items() if not function.builtin]

    def is_users(self, name: str) -> bool:
        """Checks whether a name calls a user's function."""
        function = self.function(name)
        return function is not None and not function.builtin

    def builtin(self, name: str) -> Function | None:
        """Returns the language's own function of plain values; None if there is none."""
        return BUILTINS.get(name)

    def check_call(self, node: ast.Call) -> None:
        """Checks that a function is known, and the number of its arguments."""
        count = len(node.arguments)
        name = written_name(node.name).removeprefix(OF_MARGINS)
        if node.name in RELATIONS:
            relation = RELATIONS[node.name]
            minimum, maximum = min(relation.expressions), max(relation.expressions)
            fits, usage = count in relation.expressions, _CALLS.get(name, relation.usage)
            if count == 1 and [p.name for p in relation.parameters[:2]] == ["a", "b"]:
                usage = _PAIR.format(name, usage)
        elif name in self.functions:
            function = self.functions[name]
            minimum, maximum = (
                function.min_arguments,
                count if function.max_arguments is None else function.max_arguments,
            )
            written = function.help.rpartition("Usage: ")[2] if function.builtin else ""
            fits, usage = minimum <= count <= maximum, written or f"see help('{name}')"
            usage = _CALLS.get(name, usage) if count != 1 or minimum > 1 else usage
        else:
            error = unknown_function(node, self.known_functions())
            worlds = [key for key, value in self.variables.items() if isinstance(value, World)]
            is_bare = node.span == node.name_span and ";" not in error.message
            if is_bare and worlds:
                error.message += f", and no variable; the worlds are {', '.join(worlds)}"
                error.suggestions = nearest(name, [*self.known_functions(), *self.variables])
            raise error
        if not fits:
            texts = (one for one in node.arguments if isinstance(one, ast.Literal))
            if count > minimum and any(type(one.value) is str for one in texts):
                usage += "; a link or a site is written by its names: room.panda.hand"
            expected = f"{minimum}" if minimum == maximum else f"{minimum} to {maximum}"
            plural = "" if expected == "1" else "s"
            raise ArgumentError(
                f"{name} takes {expected} argument{plural}, not {count}: {usage}",
                span=node.span,
            )

    def help(self, name: str | None = None) -> Any:
        """Returns the names of all functions, or the help of one, or of a word such as `IMPLIES`.

        The name may be that of a result form, too; `AS` has all of these.

        Raises:
            UnknownNameError: nothing has that name; the error suggests the nearest names.
        """
        if name is None:
            return sorted(self.known_functions(), key=str.casefold)
        if isinstance(name, str) and name.upper() == "AS":
            return help_of_result_forms()
        if isinstance(name, str) and name.upper() in HELP_OF_WORDS:
            return f"{name.upper()}\n{HELP_OF_WORDS[name.upper()]}"
        described: dict[str, Function | Relation] = {**RELATIONS, **self.functions}
        if isinstance(name, str) and name in described:
            return f"{name}\n{described[name].help}"
        form = help_of_result_form(name) if isinstance(name, str) else None
        if form is None:
            forms = [other for each in all_adapters() for other in each.names]
            raise UnknownNameError(
                f"there is no function {short_repr(name)}",
                suggestions=nearest(name, [*self.known_functions(), *forms, *HELP_OF_WORDS]),
            )
        return form

    def known_functions(self) -> list[str]:
        """Returns the names of all functions; a program cannot write one with a space."""
        names = dict.fromkeys((*RELATIONS, *self.functions))
        return [name for name in names if " " not in name]

    def _commands(self) -> list[Function]:
        """Returns the functions that use the interpreter."""

        def clear(name: str | None = None) -> bool:
            if name is None:
                remaining = {n: v for n, v in self.variables.items() if isinstance(v, World)}
            else:
                self.variable(name)
                self._check_may_replace(name)
                remaining = {n: v for n, v in self.variables.items() if n != name}
            self.variables = remaining
            return True

        def show(*values: Any) -> Any:
            check_size(list(values))
            print(*values)  # noqa: T201  # the purpose of `print`
            return values[-1]

        about_help = "Lists all functions, or describes one or a result form."
        about_clear = "Removes a variable, or all variables except worlds."
        commands: list[tuple[str, Callable[..., Any], str, str]] = [
            ("help", self.help, about_help, "[name]"),
            ("to", lambda value, name: value, "Names a selected column.", "value, name"),  # noqa: ARG005
            ("var", self.variable, "Returns the value of the variable of a name.", "name"),
            ("clear", clear, about_clear, "[name]"),
            (
                "getTime",
                self._now,
                "Returns the simulated time of the first world, in seconds.",
                "",
            ),
            ("print", show, "Prints its arguments and returns the last one.", "value, ..."),
            ("eval", lambda text: text, "Runs a program in a text and returns its value.", "text"),
        ]
        return [_command(*command) for command in commands]

    # -- worlds and tables ------------------------------------------------------------------

    @property
    def worlds(self) -> list[World]:
        """The worlds that are bound to variables, the first one first."""
        return list(self.database.worlds.values())

    def worlds_of(self, nodes: Iterable[ast.Node]) -> list[World] | None:
        """Returns the worlds that nodes may read; None if that depends on values."""
        worlds: list[World] = []
        for node in nodes:
            called = calls_of(node)
            if not called.isdisjoint(("var", "eval")) or any(map(self.is_users, called)):
                return None
            values = [self.variables.get(name) for name in variables_of(node)]
            for value in values:
                if isinstance(value, LazyList):
                    value_worlds = self.worlds_of([value.node])
                else:
                    value_worlds = worlds_in(
                        value.values if isinstance(value, ValueHistory) else value
                    )
                if value_worlds is None:
                    return None
                worlds += value_worlds
        return worlds

    def tables_read(self, node: ast.Node) -> frozenset[str]:
        """Returns the tables that the relations in a node look up."""
        tables = tables_of(node) | tables_read_by(forms_of(node))
        if mentions_links(node, self.variables):
            tables |= {"links"}
        for name in variables_of(node):
            value = self.variables.get(name)
            if isinstance(value, LazyList):
                tables |= self.tables_read(value.node)
        return tables


def check_name(name: str, owner: str) -> None:
    """Checks the name of a variable or a function."""
    validation.identifier(name, owner)
    if is_reserved(name):
        raise ArgumentError(f"{name!r} cannot be {owner}'s name: it is a word of the language")


def _command(name: str, call: Callable[..., Any], about: str, usage: str) -> Function:
    function = Function.of(name, call, f"{about}\nUsage: {name}({usage})")
    min_arguments = 1 if usage.endswith("...") else function.min_arguments
    return replace(function, builtin=True, min_arguments=min_arguments)
