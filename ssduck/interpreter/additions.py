"""What users add to an interpreter: functions and tables of their own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, Self

from ssduck import validation
from ssduck.adapters.result import arrow_of
from ssduck.errors import ArgumentError
from ssduck.interpreter.execution import Execution
from ssduck.interpreter.namespace import check_name
from ssduck.interpreter.signatures import type_hints_of
from ssduck.language.analysis import OPERATOR_NAMES
from ssduck.language.builtins import Function
from ssduck.world.world import World


class ServedPage(Protocol):
    """A page of `Interpreter.view`."""

    @property
    def url(self) -> str:
        """The address of the page, with its token."""

    def close(self) -> None:
        """Stops serving."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...


class Additions:
    """What users add to an interpreter: functions and tables of their own."""

    def __init__(self, execution: Execution) -> None:
        self._execution = execution
        self._lock, self._database = execution.lock, execution.database

    def add_function(
        self, name: str, function: Callable[..., Any], help: str | None = None
    ) -> None:
        """Adds a Python function to the language.

        Args:
            name: the name of the function in programs.
            function: the function. It receives entities as handles, and plain values as Python's.
                It must be pure: the same arguments at the same tick give the same result.
            help: the text of `help('name')`; by default the docstring of the function.

        Raw SQL calls it by its name, too, if all its parameters and its result have type hints:
        bool, int, float, str or lists of these. A function of SQL's own of that name stays.

        Raises:
            ArgumentError: the name is no identifier, or the function cannot be replaced.

        Warns:
            UserWarning: the function replaces a relation, a function or an operator of the
                language (`on`, `count`, `add` for `+`) in programs of this interpreter.

        >>> import ssduck
        >>> with ssduck.Interpreter() as ss:
        ...     ss.add_function("double", lambda number: 2 * number, "Doubles a number.")
        ...     ss.eval("SELECT double(this) FROM [1, 2] AS list;")
        [2, 4]
        """
        if not isinstance(name, str) or name not in OPERATOR_NAMES:
            check_name(name, "a function")
        validation.function(function, name)
        hints = type_hints_of(function)
        with self._lock:
            added = Function.of(name, function, help, hints)
            self._execution.add_function(added)
            self._execution.forget_plans()
            if hints is not None:
                self._database.offer_function(added, hints.parameters, hints.result)

    def del_function(self, name: str) -> None:
        """Removes a function that was added; the function that it replaced is back.

        Raises:
            UnknownNameError: no such function was added; the error suggests the nearest names.
        """
        with self._lock:
            self._execution.remove_function(name)
            self._execution.forget_plans()
            self._database.withdraw_function(name)

    def register(self, name: str, frame: Any) -> None:
        """Makes a frame that you hold a table of raw SQL and a source of programs.

        Args:
            name: the name of the table and of the variable; a frame of that name is replaced.
            frame: a data frame of pandas or polars, an Arrow table, a `Result`, or columns by name
                as lists or arrays. It is copied as it is now.

        Raises:
            ArgumentError: the name is no identifier, or that of a world, of one of its tables or
                of a table of yours; or the value is no frame.

        >>> import ssduck
        >>> with ssduck.load("kitchen") as ss:
        ...     ss.register("prices", {"name": ["cup", "table"], "price": [1.5, 80.0]})
        ...     ss.sql("SELECT name, price FROM entities JOIN prices USING (name)").fetchall()
        ...     ss.eval("SELECT p.price FROM e=kitchen, p=prices WHERE p.name == e.name AS list;")
        [('table', 80.0)]
        [80.0]
        """
        check_name(name, "a table")
        with self._lock:
            if isinstance(self._execution.variables.get(name), World):
                raise ArgumentError(f"register: {name!r} is the name of a world")
            table = arrow_of(frame)
            self._database.register(name, table)
            self._execution.bind(name, table)
