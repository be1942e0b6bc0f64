"""Evaluates the terms of a task, with at most a statement a step: `Judge`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from ssduck.errors import ArgumentError, SelectScriptError, UnknownNameError
from ssduck.formatting import joined_names, short_repr
from ssduck.gym.terms import CONDITIONS, Judgement, Term, Terms, compiled, is_nan
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.over_time.each_tick import ExpressionsAtTicks, JudgedFolds
from ssduck.interpreter.over_time.functions import TEMPORAL_FUNCTIONS, expressions_of, parts_of
from ssduck.interpreter.program import CompiledProgram
from ssduck.language import ast
from ssduck.language.analysis import OF_MARGINS
from ssduck.language.builtins import MARGIN_OF_TRUTH
from ssduck.schema import RECORDABLE, TWIST
from ssduck.simulators.interface import Body
from ssduck.sql.relation_calls import tables_of
from ssduck.sql.relations.registry import RELATIONS
from ssduck.world.world import World

# What to do about the past of a variable.
_KEEP_PAST = (
    "let the environment keep what the term needs of earlier steps, and give that as a variable, "
    "such as variables={'before': lambda env: env.before}"
)

# The relations and columns that say how fast something moves.
_OF_MOTION = frozenset(
    {name for name, relation in RELATIONS.items() if relation.unit in ("m/s", "rad/s")} | set(TWIST)
)


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
        needs_record: whether these have to be recorded though each tick is judged.
        are_sensitive: of each term, whether it may change a lot within a step of the simulator: a
            condition, and a number that says how fast something moves or that reads the past.
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
        texts = [self._expanded(term) for term in terms]
        # What is not decided yet does not hold.
        self._texts = [
            f"IF({text}\n; True; False)" if term.is_condition and is_decided_later(tree) else text
            for term, text, tree in zip(terms, texts, map(self._tree, texts), strict=True)
        ]
        # Each was compiled by itself, so that none is more than an expression.
        self._program = interpreter.compile(_selected(self._texts))
        trees = [self._tree(text) for text in self._texts]
        for term, text, tree in zip(terms, self._texts, trees, strict=True):
            _check_margins(term, text, tree)
        self._are_temporal = [_is_temporal(tree) for tree in trees]
        self.are_sensitive = [
            term.is_condition or is_temporal or not _OF_MOTION.isdisjoint(_names(tree))
            for term, tree, is_temporal in zip(terms, trees, self._are_temporal, strict=True)
        ]
        # The terms that have a variable in a function of time or a query of the past, with that, by
        # the variable.
        self._over_time: dict[str, tuple[Term, str]] = {}
        for term, tree in zip(terms, trees, strict=True):
            self._find_over_time(term, tree)
        # The conditions in heldFor and holds, with the numbers of their terms.
        self._held = [
            (number, text[held.span.start : held.span.end])
            for number, (text, tree) in enumerate(zip(self._texts, trees, strict=True))
            for held in _held_conditions(tree)
        ]
        self._at_ticks: ExpressionsAtTicks | None = None
        # The entities that were NaN at a tick of the episode.
        self._were_nan: set[str] = set()
        self.past_tables: frozenset[str] = frozenset()
        if any(self._are_temporal):
            read = frozenset().union(*map(tables_of, trees)).intersection(RECORDABLE)
            self.past_tables = read | {"entities", "links"}
        self._folds = JudgedFolds(interpreter, trees, self._whole | self._element_names)
        self.needs_record = self._folds.need_record

    @property
    def world(self) -> World:
        """The world of the terms."""
        world = self._interpreter[self._world]
        assert isinstance(world, World)
        return world

    def begin_episode(self) -> None:
        """Forgets the values of variables."""
        self._bound.clear()
        for name in self._elements:
            self._interpreter.add_variable(name, None)

    def begin_step(self) -> None:
        """Tells that the tick that follows is to be judged; `settle` ends it."""
        self._folds.are_asked = True

    def begin_tick(self, values: Mapping[str, Any], *, is_first: bool = False) -> None:
        """Sets the variables of the present tick."""
        if is_first:
            self._were_nan.clear()
            if not self.needs_record:
                self.world.follow(self._folds)
        if any(self._are_temporal):
            self._were_nan.update(self._entities_with_nan())
        for name, value in values.items():
            for index in self._elements[name]:
                try:
                    element = value[index]
                except (TypeError, IndexError, KeyError):
                    raise ArgumentError(
                        f"variables[{name!r}]: a term uses {name}[{index}], and the value is "
                        f"{short_repr(value)}"
                    ) from None
                self._bind(self._element(name, index), element, f"{name}[{index}]", is_first)
            if name in self._whole:
                self._bind(name, value, name, is_first)

    def _bind(self, name: str, value: Any, shown: str, is_first: bool) -> None:
        """Sets a variable unless it has the value already: what reads it need not be found anew."""
        bound = self._bound.get(name)
        is_over_time = name in self._over_time and not is_first
        if is_over_time and bound != value and not _has_nan(value):  # the terms tell of NaN
            self._raise_changed(name, shown, bound, value)
        if not (is_same(bound, value) and self._interpreter[name] is bound):
            self._bound[name] = self._interpreter.add_variable(name, value)
            if _has_nan(self._bound[name]):  # what compares it is unknown, too
                self._interpreter.add_variable(name, _without_nan(self._bound[name]))

    def _raise_changed(self, name: str, shown: str, before: Any, value: Any) -> None:
        """Raises the error of a variable in a function of time that has changed."""
        term, function = self._over_time[name]
        raise ArgumentError(
            f"{term.key}: {term.text!r} has the variable {shown} in {function}, which takes its "
            "present value at all past ticks, and it changed within the episode, from "
            f"{short_repr(before)} to {short_repr(value)}: {_KEEP_PAST}"
        )

    def _find_over_time(self, term: Term, tree: ast.Node) -> None:
        """Finds the variables of a term in functions of time, and in queries of the past."""
        for call in tree.walk():
            if isinstance(call, ast.Query) and any(map(_is_past, call.sources)):
                parts = [part for part in call.children() if not isinstance(part, ast.Source)]
                names = {n.name for part in parts for n in part.walk() if isinstance(n, ast.Name)}
                for name in names & (self._whole | self._element_names):
                    self._over_time.setdefault(name, (term, f"a query of {self._world}{{…}}"))
            if not (
                isinstance(call, ast.Call) and call.name in TEMPORAL_FUNCTIONS and call.arguments
            ):
                continue
            nodes = [part for one in expressions_of(call) for part in one.walk()]
            names = {node.name for node in nodes if isinstance(node, ast.Name)}
            variables = names & (self._whole | self._element_names)
            if (
                variables
                and variables == names
                and not any(
                    isinstance(node, ast.QualifiedName | ast.TimeIndex | ast.Query)
                    for node in nodes
                )
            ):
                raise ArgumentError(
                    f"{term.key}: {term.text!r} has {call.name}(…) of variables alone, whose past "
                    f"is not known: {_KEEP_PAST}"
                )
            for name in variables:
                self._over_time.setdefault(name, (term, f"{call.name}(…)"))

    def _element(self, name: str, index: int) -> str:
        """Returns the name of an element of a list that a variable has, which none else has."""
        element = f"{name}__{index}"
        while element in self._elements:
            element += "_"
        return element

    @property
    def _element_names(self) -> set[str]:
        """The names of the elements of lists that terms use."""
        indices = self._elements.items()
        return {self._element(name, index) for name, used in indices for index in used}

    def judgement(self) -> Judgement:
        """Returns the values of the terms at the present tick."""
        try:
            return self._judgement()
        finally:
            self.settle()

    def why_success(self) -> str:
        """Returns the parts of success at the present tick, as `WHY` tells them."""
        assert self.terms.success is not None
        return str(self._interpreter.why(f"{self._expanded(self.terms.success)};"))

    def settle(self) -> None:
        """Adds the present tick to functions of time that no term has needed at it."""
        self._folds.are_asked = False
        self._folds.settle()

    def _judgement(self) -> Judgement:
        try:
            values = self._interpreter.eval(self._program)
        except SelectScriptError as error:
            values = []
            if isinstance(error, ArgumentError) and (self._nan_sources() or self._were_nan):
                values = [self._value_or_nan(text) for text in self._texts]
            if not values or not (self._nan_sources() or self._has_nan_past(values)):
                for term, text in zip(self.terms, self._texts, strict=True):
                    # The error gets the key of its term.
                    self._value(term, compiled(self._interpreter, term.key, text))
                raise
        if self._held and self._nan_sources():  # heldFor and holds of what is unknown now
            unknown = {place for place, text in self._held if self._value_or_nan(text) is None}
            values = [None if n in unknown else value for n, value in enumerate(values)]
        sources = ""
        if any(map(is_nan, values)):
            sources = self._nan_sources(values)
            if not sources and self._has_nan_past(values):
                names = joined_names(sorted(self._were_nan))
                sources = f"the pose or the velocity of {names} was NaN at an earlier step"
        if sources:
            return self.terms.judgement_of_nan(values, sources)
        return self.terms.judgement(values)

    def judgements(
        self, times: Sequence[float], variables: Sequence[Mapping[str, Any]]
    ) -> list[Judgement] | None:
        """Returns the values of the terms at the ticks of a recorded episode."""
        try:
            if self._at_ticks is None:
                trees = list(map(self._tree, self._texts))
                self._at_ticks = ExpressionsAtTicks(self._interpreter, trees, self._world)
            named = list(map(self._named_values, variables))
            if any(_has_nan(value) for values in named for value in values.values()):
                return None
            found = self._at_ticks.values(times, named)
            if found is None or any(any(map(is_nan, values)) for values in found):
                return None
            return list(map(self.terms.judgement, found))
        except (SelectScriptError, LookupError, TypeError):
            return None

    def _named_values(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Returns the values of variables, and of their elements, by the names in the terms."""
        named = {name: values[name] for name in self._whole}
        elements = self._elements.items()
        return named | {
            self._element(name, index): values[name][index]
            for name, used in elements
            for index in used
        }

    def _has_nan_past(self, values: Sequence[Any]) -> bool:
        """Checks whether what terms lack may be that of a past tick that was NaN."""
        pairs = zip(values, self._are_temporal, strict=True)
        return bool(self._were_nan) and all(past for value, past in pairs if is_nan(value))

    def _entities_with_nan(self) -> list[str]:
        """Returns the entities whose pose or velocity is NaN at the present tick."""
        entities = self.world.snapshot.entities_with_nan()
        return [f"{self._world}.{entity.name}" for entity in entities]

    def _value_or_nan(self, text: str) -> Any:
        """Returns the value of a term; None if it fails, as it does where a number is NaN."""
        try:
            return self._interpreter.eval(_selected([text]))[0]
        except ArgumentError:
            return None

    def _nan_sources(self, values: Sequence[Any] = ()) -> str:
        """Returns what is NaN at the present tick, of which terms may depend; '' if nothing is."""
        names = self._entities_with_nan()
        sources = [f"the pose or the velocity of {joined_names(names)} is"] if names else []
        variables = [name for name, value in self._bound.items() if _has_nan(value)]
        sources += [f"the variable {name} has" for name in variables]
        if not sources and any(map(_has_nan, values)):
            return "what it computes is no number"
        return " NaN, and ".join(sources) + " NaN at this step" if sources else ""

    def check(self, *, may_be_constant: bool = False, with_variables: bool = True) -> None:
        """Checks each term by itself at the present tick."""
        for term, text in zip(self.terms, self._texts, strict=True):
            program = compiled(self._interpreter, term.key, text)
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
        for node in program.tree.statements[0].walk():
            if isinstance(node, ast.Name) and node.span == error.span:
                if node.name in self.terms.parts:
                    return "; terms can use success and failure: write that of the reward out"
                is_hinted = (
                    node.name in self.world or error.suggestions or node.name in self._interpreter
                )
                return "" if is_hinted else f"; {self._if_unknown.format(name=node.name)}"
        return ""

    def _tree(self, text: str) -> ast.Node:
        tree = compiled(self._interpreter, "term", text).tree.statements[0]
        return self._interpreter._execution.expanded(tree)  # noqa: SLF001  # one package

    def _expanded(self, term: Term) -> str:
        """Returns the text of a term with the conditions that it names, and elements of lists."""
        text, known = term.text, self.terms
        replacements: list[tuple[int, int, str]] = []

        def visit(node: ast.Node) -> ast.Node | None:
            match node:
                case ast.Index(
                    base=ast.Name(name=name), indices=(ast.Literal(value=int() as index),)
                ) if name in self._elements and index >= 0 and not isinstance(index, bool):
                    self._elements[name].add(index)
                    replacement = self._element(name, index)
                case ast.Name(name=name) if name in self._elements:
                    self._whole.add(name)
                    return node
                case ast.Name(name=name) if name == term.key:
                    raise ArgumentError(f"{name} is what this term decides: it cannot use itself")
                case ast.Name(name=name) if name in CONDITIONS:
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

        compiled(self._interpreter, term.key, text).tree.statements[0].replaced(visit)
        for start, end, replacement in sorted(replacements, reverse=True):
            text = text[:start] + replacement + text[end:]
        return text

    def _uses_variables(self, program: CompiledProgram) -> bool:
        """Checks whether a program uses variables that are set at each step."""
        variables = self._element_names.union(self._elements)
        nodes = program.tree.statements[0].walk()
        return any(isinstance(node, ast.Name) and node.name in variables for node in nodes)

    def _bodies(self) -> dict[str, Body | None]:
        """Returns the bodies of the entities by name; None for a sensor."""
        return {entity.name: entity.body for entity in self.world.snapshot.entities}

    def _entity_name(self, node: ast.Node) -> str:
        """Returns the name of the entity of the world that an expression is; '' if it is none."""
        match node:
            case ast.Index(
                base=ast.Name(name=self._world), indices=(ast.Literal(value=str() as name),)
            ):
                return name
            case ast.QualifiedName(alias=self._world, key=name):
                return name
        return ""

    def _check_changes(self, term: Term, program: CompiledProgram) -> None:
        """Checks that the value of a term may differ from step to step."""
        names: set[str] = set()
        is_open = False
        entities: set[str] = set()

        def visit(node: ast.Node) -> ast.Node | None:
            nonlocal is_open
            if name := self._entity_name(node):
                entities.add(name)
                return node
            match node:
                case ast.Name(name=name) | ast.TimeIndex(name=name):
                    names.add(name)
                case ast.Query() | ast.Call(name="getTime"):
                    is_open = True
            return None

        tree = program.tree.statements[0]
        if not term.is_condition and isinstance(_unsigned(tree), ast.Literal):
            return  # a bonus or a penalty of each step
        tree.replaced(visit)
        if is_open or self._world in names or self._uses_variables(program):
            return
        if not entities:
            raise ArgumentError(
                f"{term.key}: {term.text!r} can never change: it has no entity of {self._world!r}, "
                f"such as {self._world}.cup, and no variable"
            )
        bodies = self._bodies()
        known = [bodies.get(name) for name in sorted(entities)]
        if all(body is not None and not body.movable for body in known):
            raise ArgumentError(
                f"{term.key}: {term.text!r} can never change: no joint moves "
                f"{' or '.join(sorted(entities))}; if a reset moves it, give its place as a "
                "variable: variables={'place': lambda env: …}"
            )


def _check_variables(names: Sequence[str], terms: Terms, world: str) -> None:
    """Checks that no variable takes the place of the world, or of a term that others may name."""
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


def _has_nan(value: Any) -> bool:
    """Checks whether the value of a variable is NaN, or a list that has it."""
    if isinstance(value, list):
        return any(map(_has_nan, value))
    return isinstance(value, float) and math.isnan(value)


def _without_nan(value: Any) -> Any:
    """Returns a value with None in place of NaN, as the tables have it."""
    if isinstance(value, list):
        return list(map(_without_nan, value))
    return None if _has_nan(value) else value


def _check_margins(term: Term, text: str, tree: ast.Node) -> None:
    """Checks that a number is known at each step, and finite."""
    if term.is_condition:
        return
    for part in tree.walk():
        written = text[part.span.start : part.span.end]
        if isinstance(part, ast.Call) and part.name == MARGIN_OF_TRUTH:
            raise ArgumentError(
                f"{term.key}: {written} has no margin: robustness would be infinite"
            )
        if isinstance(part, ast.Call) and part.name.startswith(OF_MARGINS) and looks_ahead(part):
            raise ArgumentError(
                f"{term.key}: {term.text!r} looks ahead, and is nothing while an episode goes on: "
                "write historically in place of always, once in place of eventually"
            )


def is_decided_later(node: ast.Node) -> bool:
    """Checks whether a condition looks ahead, and may hold: `always` without an end does not."""
    is_endless = isinstance(node, ast.Call) and node.name == "always" and len(node.arguments) < 3
    return looks_ahead(node) and not is_endless


def looks_ahead(node: ast.Node) -> bool:
    """Checks whether a part depends on later ticks."""
    return any(
        isinstance(part, ast.Call)
        and part.name in TEMPORAL_FUNCTIONS
        and TEMPORAL_FUNCTIONS[part.name].looks_ahead
        for part in node.walk()
    )


def _held_conditions(node: ast.Node) -> Iterator[ast.Node]:
    """Yields the conditions in heldFor and holds, but for those of the rows of a query."""
    if isinstance(node, ast.Call) and node.name in ("heldFor", "holds"):
        yield parts_of(node)[0]
    if not isinstance(node, ast.Query):
        for child in node.children():
            yield from _held_conditions(child)


def _unsigned(node: ast.Node) -> ast.Node:
    return _unsigned(node.operand) if isinstance(node, ast.Unary) else node


def _names(node: ast.Node) -> set[str | None]:
    """Returns the names of functions, columns and variables in an expression."""
    return {getattr(part, key, None) for part in node.walk() for key in ("name", "key")}


def _is_past(source: ast.Source) -> bool:
    """Checks whether a source has past ticks, as sim{} and links(sim{0.0}) have."""
    return any(isinstance(node, ast.TimeIndex) for node in source.value.walk())


def _is_temporal(node: ast.Node) -> bool:
    """Checks whether an expression reads the past."""
    return any(
        isinstance(part, ast.TimeIndex)
        or (isinstance(part, ast.Call) and part.name in TEMPORAL_FUNCTIONS)
        for part in node.walk()
    )
