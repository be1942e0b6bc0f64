"""Registers result forms and finds them by the name after AS.

Each module of this package defines the built-in forms of one topic. Users add forms with
`adapter`, packages with entry points of the group `ssduck.adapters`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Iterable
from importlib.metadata import entry_points
from typing import Any, TypeVar, get_args

from ssduck import validation
from ssduck.adapters.base import Adapter, Need
from ssduck.adapters.grids import GRIDS
from ssduck.adapters.logic import LOGIC
from ssduck.adapters.network import NETWORK
from ssduck.adapters.spatial import SPATIAL, WORLDS
from ssduck.adapters.tabular import TABULAR, VALUES
from ssduck.errors import ArgumentError, UnknownNameError, check_known, nearest
from ssduck.formatting import error_text, short_repr

Maker = TypeVar("Maker", bound=Callable[..., Any])

GROUP = "ssduck.adapters"

_ADAPTERS: dict[str, Adapter] = {
    name: form
    for form in (*VALUES, *TABULAR, *LOGIC, *NETWORK, *GRIDS, *SPATIAL, *WORLDS)
    for name in form.names
}
_BUILT_IN = frozenset(_ADAPTERS)
# The grammar has these words, in upper or lower case.
_WORDS = frozenset(name for form in VALUES for name in form.names)
# The tables that a form may read beside that of entities.
_TABLES = ("links", "joints", "shapes", "contacts", "sensings")
# The words of other tools for a form, in lower case.
_OTHER_WORDS = {
    "list": ("array", "tuple", "set", "values", "names", "ids"),
    "numpy": ("array", "np", "ndarray", "matrix"),
    "value": ("scalar", "number", "int", "float", "bool", "single", "one", "first"),
    "dict": ("dicts", "rows", "objects", "mapping"),
    "records": ("rows", "tuples", "namedtuples", "structs"),
    "df": ("frame", "series"),
    "json": ("text", "string", "str", "yaml"),
    "csv": ("text", "string", "str", "tsv", "excel"),
    "image": ("picture", "png", "plot", "pic", "photo"),
}


def adapter(
    *names: str, needs: Need = "rows", help: str | None = None, tables: Collection[str] = ()
) -> Callable[[Maker], Maker]:
    """Makes a function a result form, which programs request by `AS name`.

    The function gets a `Selection` (`rows`, `columns`, `entities`, `world`, `tick`, `time`,
    `query`) and the arguments after AS.

    Args:
        names: the names in programs; by default the name of the function.
        needs: the input; see `Adapter`. By default all rows.
        help: the text that `help('AS')` shows; by default the docstring of the function.
        tables: the tables of a tick, beside `entities`, that the function reads: `"links"`,
            `"joints"`, `"shapes"`, `"contacts"`, `"sensings"`.

    Returns:
        A decorator that registers a function and returns it unchanged.

    Raises:
        ArgumentError: a name is not an identifier, or belongs to a built-in form.
        UnknownNameError: there is no such input or table; with the nearest names.

    >>> import ssduck
    >>> @ssduck.adapter("rowcount")
    ... def rowcount(selection, least=0):
    ...     "The number of rows, or `least` if there are fewer."
    ...     return max(len(selection.rows), least)
    >>> with ssduck.Interpreter() as ss:
    ...     ss.eval("SELECT n.this FROM n=[1] AS rowcount(2);")
    2
    """
    for name in names:
        _check_name(name)
    for kind, given, known in (("input", [needs], get_args(Need)), ("table", tables, _TABLES)):
        for word in given:
            message = f"adapter: there is no {kind} {short_repr(word)}: {', '.join(known)}"
            check_known(word, known, message)

    def register(make: Maker) -> Maker:
        registered = names or (make.__name__,)
        for name in registered:
            _check_name(name)
        description = help or inspect.getdoc(make) or "A form of your own."
        form = Adapter(registered, description, make, needs, tables=frozenset(tables))
        _ADAPTERS.update(dict.fromkeys(registered, form))
        return make

    return register


def _check_name(name: Any) -> None:
    if callable(name):
        raise ArgumentError("adapter is called before it decorates: @ssduck.adapter()")
    validation.identifier(name, "a form")
    if name in _BUILT_IN or name.lower() in _WORDS:
        raise ArgumentError(f"AS {name} is one of ssduck's own forms; choose another name")


def find(name: str) -> Adapter:
    """Returns the form of a name, preferring the exact spelling to one in another case.

    >>> find("df").usage
    'AS df | pandas | dataframe'
    """
    if name in _ADAPTERS:
        return _ADAPTERS[name]
    provided = _entry_points()
    if name not in provided:
        return find(_exact_spelling(name, {*_ADAPTERS, *provided}))
    _ADAPTERS[name] = _load(name, provided[name])
    return _ADAPTERS[name]


def _exact_spelling(name: str, known: Collection[str]) -> str:
    """Returns the exact spelling of a form that a program writes in another case."""
    spellings = sorted(other for other in known if other.casefold() == name.casefold())
    if len(spellings) > 1:
        listed = " or ".join(spellings)
        raise ArgumentError(f"AS {name} is ambiguous; write AS {listed}")
    if not spellings:
        message = f"there is no result form {short_repr(name)}"
        same = tuple(form for form, words in _OTHER_WORDS.items() if name.casefold() in words)
        near = same or nearest(name, known)
        if not near:
            message += "; some are list, value, dict, df and json: help('AS') lists all"
        raise UnknownNameError(message, suggestions=near)
    return spellings[0]


def tables_read_by(names: Iterable[str]) -> frozenset[str]:
    """Returns the tables, beside `entities`, that forms read; unknown names count as none."""
    forms: set[Adapter] = set()
    for name in names:
        folded = name.casefold()
        same = {form for known, form in _ADAPTERS.items() if known.casefold() == folded}
        forms |= {_ADAPTERS[name]} if name in _ADAPTERS else same
    return frozenset(table for form in forms for table in form.tables)


def all_adapters() -> list[Adapter]:
    """Returns all forms, the built-in ones first; packages that fail to import are left out."""
    for name in _entry_points().keys() - _ADAPTERS.keys():
        try:
            find(name)
        except ArgumentError:  # reported when a program uses the form
            continue
    return loaded_adapters()


def loaded_adapters() -> list[Adapter]:
    """Returns the forms that are loaded, the built-in ones first, without looking for packages."""
    return list(dict.fromkeys(_ADAPTERS.values()))


def _entry_points() -> dict[str, Any]:
    return {point.name: point for point in entry_points(group=GROUP)}


def _load(name: str, point: Any) -> Adapter:
    """Imports the form of an entry point: an `Adapter` or a function."""
    try:
        loaded = point.load()
    except Exception as error:
        raise ArgumentError(
            f"AS {name}: {point.value} cannot be loaded: {error_text(error)}"
        ) from error
    if isinstance(loaded, Adapter):
        return loaded
    if not callable(loaded):
        raise ArgumentError(f"AS {name}: {point.value} is no function and no Adapter")
    return Adapter((name,), inspect.getdoc(loaded) or f"A form of {point.value}.", loaded)
