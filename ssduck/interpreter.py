"""`Interpreter`: variables, functions, running programs and raw SQL.

A program's statements run in order; its value is that of the last one. A program that fails
leaves the variables as they were. A query is translated once per text and types
(`ssduck.translate`), runs as one SQL statement on one tick of each world, and what is left of
it is evaluated in Python on the rows that come back (`ssduck.queries`).
"""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

from ssduck.adapters import ADAPTERS, Adapter, Rows
from ssduck.database import Database
from ssduck.errors import (
    ArgumentError,
    EvaluationError,
    FunctionError,
    ParseError,
    SelectScriptError,
    UnknownNameError,
    nearest,
)
from ssduck.evaluate import Evaluator
from ssduck.expressions import sees_outside
from ssduck.functions import BUILTINS, Function
from ssduck.language import is_reserved, parse
from ssduck.plan import Plan, Tag
from ssduck.queries import Planned, shapes_of, tag_of
from ssduck.result import Result
from ssduck.scenes import find_scene
from ssduck.translate import translate, unknown_function
from ssduck.tree import Call, Given, Node, Program, Query
from ssduck.udfs import RELATIONS, Relation
from ssduck.world import World

# So many queries keep their plans; then all are forgotten and made anew as they are needed.
MOST_PLANS = 500


def load(scene: str | Path, database: str = ":memory:") -> Interpreter:
    """An interpreter with a scene's world bound to the scene's name.

    Args:
        scene: the name of a shipped scene, or the path of a scene file, or of a model
            (URDF, SDF or MJCF).
        database: a DuckDB file, or `":memory:"`.

    Raises:
        UnknownNameError: there is no such scene, with the nearest names.
        SceneError: it cannot be loaded: file, key and reason.
    """
    description = find_scene(scene)
    interpreter = Interpreter(database)
    try:
        world = World.load(description)
        interpreter._own.append(world)  # noqa: SLF001  # it closes what is made here
        interpreter.add_variable(description.name, world)
    except BaseException:
        interpreter.close()
        raise
    return interpreter


class Interpreter:
    """Runs SelectScript programs and raw SQL on worlds.

    Args:
        database: a DuckDB file, or `":memory:"`.
        tracer: is told each SQL statement before it runs.
    """

    def __init__(
        self, database: str = ":memory:", *, tracer: Callable[[str], None] | None = None
    ) -> None:
        self._database = Database(database, tracer)
        self._lock = threading.RLock()
        self.schema_of = self._database.schema_of
        self._variables: dict[str, Any] = {}
        self._functions: dict[str, Function] = dict(BUILTINS)
        self._functions.update((command.name, command) for command in self._commands())
        self._own: list[World] = []
        self._plans: dict[Query, list[Planned]] = {}
        self._relations: dict[Call, Query] = {}

    def close(self) -> None:
        """Close the database, and the world that `load` made; yours stay open."""
        for world in self._own:
            world.close()
        self._database.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- programs -------------------------------------------------------------------------

    def compile(self, text: str) -> Program:
        """Parse a program; running the result again parses nothing.

        Raises:
            ParseError: with the place of the first thing that is wrong.
        """
        return parse(text)

    def eval(self, program: str | Program) -> Any:
        """Run a program.

        Args:
            program: its text, or what `compile` gave.

        Returns:
            The value of the last statement, None if there is none.

        Raises:
            SelectScriptError: with the place; the variables are as they were before.
        """
        compiled = _compiled(program)
        with self._undone_on_failure(compiled):
            return self._run(compiled)

    def explain(self, program: str | Program) -> str:
        """The SQL of the queries in a program's last statement, and what is left to Python.

        The statements before it are run for their variables, which are then as before.

        Raises:
            SelectScriptError: as `eval` does.
        """
        compiled = _compiled(program)
        with self._undone_on_failure(compiled):
            before = dict(self._variables)
            told = self._explained(compiled)
            self._variables = before
            return told

    @contextmanager
    def _undone_on_failure(self, program: Program) -> Iterator[None]:
        """Whatever fails in here leaves the variables as they were, and says where it failed."""
        with self._lock:
            before = dict(self._variables)
            try:
                yield
            except BaseException as error:
                self._variables = before
                if isinstance(error, SelectScriptError):
                    error.locate(program.text)
                if isinstance(error, RecursionError):
                    raise ParseError("the program is nested too deeply") from error
                raise

    def _run(self, program: Program) -> Any:
        if program.explain:
            return self._explained(program)
        evaluator = Evaluator(self)
        value = None
        for node in program.statements:
            value = evaluator.value(node)
        return value

    def _explained(self, program: Program) -> str:
        evaluator = Evaluator(self)
        for statement in program.statements[:-1]:
            evaluator.value(statement)
        queries = [
            node
            for statement in program.statements[-1:]
            for node in statement.walk()
            if isinstance(node, Query) and not sees_outside(node)
        ]
        return "\n\n".join(self._told(program.text, query, evaluator) for query in queries)

    def _told(self, text: str, query: Query, evaluator: Evaluator) -> str:
        values = [evaluator.value(source.value) for source in query.sources]
        plan = self._planned(query, values, _Typed(self, evaluator)).plan
        lines = [plan.select.sql(dialect="duckdb", pretty=True)]
        lines += [f"-- left to Python: {text[n.span.start : n.span.end]}" for n in plan.left]
        return "\n".join(lines)

    # -- variables and functions ----------------------------------------------------------

    def add_variable(self, name: str, value: Any) -> Any:
        """Bind a value to a name; a world's tables become the schema of that name.

        Returns:
            The value.

        Raises:
            ArgumentError: the name cannot be a variable's, or a schema's.
        """
        _check_name(name, "a variable")
        with self._lock:
            if isinstance(value, World):
                self._database.bind(name, value)
                self._forget_plans()
            self._variables[name] = value
        return value

    def call_variable(self, name: str) -> Any:
        """The value of a variable.

        Raises:
            UnknownNameError: there is none, with the nearest names.
        """
        return self.variable(name)

    def add_function(
        self, name: str, function: Callable[..., Any], help: str | None = None
    ) -> None:
        """Make a Python function part of the language.

        Args:
            name: what programs call it.
            function: gets entities as handles, and plain values as Python's. It is taken to be
                pure: the same arguments on the same tick, the same result.
            help: what `help('name')` tells; by default its docstring.

        Raises:
            ArgumentError: the name is that of a relation or of a function of the language.
        """
        _check_name(name, "a function")
        known = self._functions.get(name)
        if name in RELATIONS or (known is not None and known.builtin):
            raise ArgumentError(f"{name!r} is a function of the language; choose another name")
        if not callable(function):
            raise ArgumentError(f"{name}: {function!r} is no function")
        with self._lock:
            self._functions[name] = Function.of(name, function, help)
            self._forget_plans()

    def help(self, name: str | None = None) -> Any:
        """The names of all functions, or the help of one.

        Raises:
            UnknownNameError: there is no such function, with the nearest names.
        """
        if name is None:
            return sorted(self._known_functions(), key=str.casefold)
        described: dict[str, Function | Relation] = {**self._functions, **RELATIONS}
        if name not in described:
            raise UnknownNameError(
                f"there is no function {name!r}", suggestions=nearest(name, described)
            )
        return f"{name}\n{described[name].help}"

    def _known_functions(self) -> list[str]:
        return [*RELATIONS, *self._functions]

    # The tutorial's spellings.
    addVariable = add_variable  # noqa: N815
    callVariable = call_variable  # noqa: N815
    addFunction = add_function  # noqa: N815

    # -- raw SQL --------------------------------------------------------------------------

    def sql(self, text: str, parameters: Sequence[Any] | Mapping[str, Any] | None = None) -> Result:
        """Run SQL on the worlds' tables.

        The tables of a world bound as `kitchen` are `kitchen.entities` and so on; those of the
        first world go without the schema. Relations are functions of rows:
        `FROM entities a, entities b WHERE above(a, b)`.

        Args:
            text: one SQL statement in DuckDB's dialect.
            parameters: for `?` and `$1` a sequence, for `$name` a mapping.

        Returns:
            All its rows; stepping the world does not change them.

        Raises:
            SqlError: DuckDB refuses it.
        """
        return Result(self._database.table(text, parameters))

    # -- functions that need the interpreter ------------------------------------------------

    def _commands(self) -> list[Function]:
        def clear(name: str | None = None) -> bool:
            if name is None:
                kept = {n: v for n, v in self._variables.items() if isinstance(v, World)}
            else:
                self.variable(name)
                kept = {n: v for n, v in self._variables.items() if n != name}
            self._variables = kept
            return True

        def get_time() -> float:
            worlds = list(self._database.worlds.values())
            if not worlds:
                raise UnknownNameError("there is no world, so no simulated time")
            return worlds[0].time

        def show(*values: Any) -> Any:
            print(*values)  # noqa: T201  # it is what the language's print is for
            return values[-1]

        return [
            _command("help", self.help, "Lists all functions, or tells what one does.", "[name]"),
            _command("to", lambda value, name: value, "Names a selected column.", "value, name"),  # noqa: ARG005
            _command("var", self.variable, "Returns the variable of that name.", "name"),
            _command("clear", clear, "Forgets a variable, or all but the worlds.", "[name]"),
            _command("getTime", get_time, "Returns the simulated time in seconds.", ""),
            _command("print", show, "Prints its arguments and returns the last.", "value, ..."),
            _command("eval", self._run_text, "Runs a program that is given as text.", "text"),
        ]

    def _run_text(self, text: str) -> Any:
        try:
            return self._run(parse(text))
        except SelectScriptError as error:
            error.locate(text)
            raise

    # -- the scope of expressions (ssduck.evaluate.Scope) -----------------------------------

    def variable(self, name: str) -> Any:
        """The value of a variable, or an UnknownNameError with the nearest names."""
        if name in self._variables:
            return self._variables[name]
        if name in self._known_functions():
            raise UnknownNameError(
                f"there is no variable {name!r}; {name} is a function: write {name}(this), say"
            )
        raise UnknownNameError(
            f"there is no variable {name!r}",
            suggestions=nearest(name, [*self._variables, *self._known_functions()]),
        )

    def has_variable(self, name: str) -> bool:
        """Whether there is a variable of that name."""
        return name in self._variables

    def assign(self, name: str, value: Any) -> None:
        """Set a variable."""
        self._variables[name] = value

    def call(self, node: Call, evaluator: Evaluator) -> Any:
        """The value of a function call outside SQL."""
        self.check_call(node)
        if node.name in RELATIONS:
            return self._relation(node, evaluator)
        arguments = [evaluator.value(argument) for argument in node.arguments]
        return self._functions[node.name](arguments)

    def check_call(self, node: Call) -> None:
        """Complain of an unknown function, or of a wrong number of arguments."""
        given = len(node.arguments)
        if node.name in RELATIONS:
            relation = RELATIONS[node.name]
            least, most = min(relation.expressions), max(relation.expressions)
            fits, usage = given in relation.expressions, relation.usage
        elif node.name in self._functions:
            function = self._functions[node.name]
            least, most = function.least, given if function.most is None else function.most
            fits, usage = least <= given <= most, f"see help('{node.name}')"
        else:
            raise unknown_function(node, self._known_functions())
        if not fits:
            wanted = f"{least}" if least == most else f"{least} to {most}"
            plural = "" if wanted == "1" else "s"
            raise ArgumentError(
                f"{node.name} takes {wanted} argument{plural}, not {given}: {usage}",
                span=node.span,
            )

    def query(self, node: Query, outer: Evaluator) -> Any:
        """The value of a query; `outer` knows the rows of the queries around it."""
        adapter = _adapter(node)
        with self._database.held():  # what it is made of is of one tick, too
            return adapter.make(self._selected(node, outer, keyed=adapter.keyed))

    def _selected(self, node: Query, outer: Evaluator, *, keyed: bool) -> Rows:
        values = [outer.value(source.value) for source in node.sources]
        typed = _Typed(self, outer)
        planned = self._planned(node, values, typed)
        if keyed:
            _check_columns(planned.plan)
        aliases = (shape.alias for shape in planned.plan.shapes)
        inner = outer.knowing(typed.values)
        return planned.run(inner, dict(zip(aliases, values, strict=True)))

    def _planned(self, query: Query, values: Sequence[Any], typed: _Typed) -> Planned:
        """The query's plan for values of these types; made anew only for new types."""
        shapes = shapes_of(query, values, self.schema_of)
        for planned in tuple(self._plans.get(query, ())):
            if planned.plan.fits(shapes, typed):
                return planned
        if sum(map(len, self._plans.values())) >= MOST_PLANS:
            self._forget_plans()
        planned = Planned(translate(query, shapes, typed), self._database)
        self._plans.setdefault(query, []).append(planned)
        return planned

    def _forget_plans(self) -> None:
        for planned in itertools.chain.from_iterable(self._plans.values()):
            planned.forget()
        self._plans.clear()
        self._relations.clear()

    def _relation(self, node: Call, evaluator: Evaluator) -> Any:
        """A relation outside a query: a query of one row, without sources."""
        query = self._relations.get(node)
        if query is None:
            names = [Given(n.span, f"argument_{i}") for i, n in enumerate(node.arguments)]
            asked = Call(node.span, node.name, tuple(names), node.name_span)
            query = self._relations[node] = Query(node.span, (asked,), ())
        (call,) = query.items
        values = [evaluator.value(argument) for argument in node.arguments]
        inner = evaluator.knowing(dict(zip(call.children(), values, strict=True)))
        typed = _Typed(self, inner)
        with self._database.held():
            planned = self._planned(query, (), typed)
            if planned.plan.left:
                raise ArgumentError(f"{node.name} does not take that", span=node.span)
            return planned.run(inner.knowing(typed.values), {}).values[0][0]


class _Typed:
    """What the translator asks: names from the interpreter, types from the values."""

    def __init__(self, interpreter: Interpreter, evaluator: Evaluator) -> None:
        self.has_variable = evaluator.scope.has_variable
        self.check_call = interpreter.check_call
        self._interpreter = interpreter
        self._evaluator = evaluator
        self.values: dict[Node, Any] = {}

    def has_source(self, alias: str) -> bool:
        return alias in self._evaluator.elements

    def tag(self, node: Node) -> Tag:
        """The type of a constant part; its value is kept, so that it is computed once a run."""
        if node not in self.values:
            try:
                self.values[node] = self._evaluator.value(node)
            except (ArgumentError, EvaluationError, FunctionError):
                return Tag("any")  # it is an error only if a row comes to it
        return tag_of(self.values[node], self._interpreter.schema_of)


def _compiled(program: str | Program) -> Program:
    if not isinstance(program, str | Program):
        raise ArgumentError(f"a program is a text or what compile gave, not {program!r}")
    return parse(program) if isinstance(program, str) else program


def _command(name: str, call: Callable[..., Any], about: str, usage: str) -> Function:
    function = Function.of(name, call, f"{about}\nUsage: {name}({usage})")
    least = 1 if usage.endswith("...") else function.least
    return replace(function, builtin=True, least=least)


def _check_name(name: str, what: str) -> None:
    if not isinstance(name, str) or not name.isidentifier():
        raise ArgumentError(f"{name!r} cannot be {what}'s name: letters, digits and _ only")
    if is_reserved(name):
        raise ArgumentError(f"{name!r} cannot be {what}'s name: it is a word of the language")


def _adapter(query: Query) -> Adapter:
    """The form that a query's rows are to take."""
    if query.adapter is None:
        return ADAPTERS["dict"]
    name = query.adapter.name
    if name not in ADAPTERS:
        raise UnknownNameError(
            f"there is no result form {name!r}",
            span=query.adapter.span,
            suggestions=nearest(name, ADAPTERS),
        )
    if query.adapter.arguments or query.adapter.named:
        raise ArgumentError(f"AS {name} takes no arguments", span=query.adapter.span)
    return ADAPTERS[name]


def _check_columns(plan: Plan) -> None:
    """Two columns of one name would leave one value out of a dict, unnoticed."""
    for index, name in enumerate(plan.names):
        if isinstance(name, str) and name in plan.names[:index]:
            raise ArgumentError(
                f"two columns are called {name!r}; name them with to(…, 'name')",
                span=plan.items[index].node.span,
            )
