"""What follows AS: forms that the rows of a query are turned into.

A form is an entry of one registry; a family of them is a module of this folder. `adapter` adds
one; so does a package that has entry points of the group `ssduck.adapters`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Iterable
from importlib.metadata import entry_points
from typing import Any, TypeVar

from ssduck import validation
from ssduck.adapters.base import Adapter, Need, Selection
from ssduck.adapters.environment import WORLDS
from ssduck.adapters.grids import GRIDS
from ssduck.adapters.logic import LOGIC
from ssduck.adapters.network import NETWORK
from ssduck.adapters.spatial import SPATIAL
from ssduck.adapters.tabular import TABULAR
from ssduck.adapters.values import VALUES
from ssduck.errors import ArgumentError, UnknownNameError, nearest
from ssduck.formatting import error_text, short_repr

Maker = TypeVar("Maker", bound=Callable[..., Any])

GROUP = "ssduck.adapters"

_ADAPTERS: dict[str, Adapter] = {
    name: form
    for form in (*VALUES, *TABULAR, *LOGIC, *NETWORK, *GRIDS, *SPATIAL, *WORLDS)
    for name in form.names
}
_BUILT_IN = frozenset(_ADAPTERS)
# These are words of the grammar, so in any case.
_WORDS = frozenset(name for form in VALUES for name in form.names)


def adapter(
    *names: str, needs: Need = "rows", help: str | None = None, tables: Collection[str] = ()
) -> Callable[[Maker], Maker]:
    """Make a function a form of results, that programs call by `AS name`.

        @ssduck.adapter("count")
        def count(selection, least=0):
            "How many rows there are, if they are enough."
            return max(len(selection.rows), least)

    Args:
        names: what programs call it; the function's own name by default.
        needs: what it reads; see `Adapter`. By default all rows.
        help: what `help('AS')` tells; by default the function's docstring.
        tables: what it reads of the tick beside the entities, so that the tick has it: `"links"`,
            `"joints"`, `"shapes"`, `"contacts"`, `"sensings"`.

    Returns:
        What makes a function such a form, and leaves the function as it is. The function is
        given a `Selection` (`rows`, `columns`, `entities`, `world`, `tick`, `time`, `query`) and
        the arguments that stand behind AS.

    Raises:
        ArgumentError: a name cannot be a form's, or is that of one of ssduck's own.
    """
    for name in names:
        _check_name(name)

    def register(make: Maker) -> Maker:
        called = names or (make.__name__,)
        for name in called:
            _check_name(name)
        told = help or inspect.getdoc(make) or "A form of your own."
        form = Adapter(called, told, make, needs, tables=frozenset(tables))
        _ADAPTERS.update(dict.fromkeys(called, form))
        return make

    return register


def _check_name(name: Any) -> None:
    if callable(name):
        raise ArgumentError("adapter is called before it decorates: @ssduck.adapter()")
    validation.identifier(name, "a form")
    if name in _BUILT_IN or name.lower() in _WORDS:
        raise ArgumentError(f"AS {name} is one of ssduck's own forms; choose another name")


def find(name: str) -> Adapter:
    """The form of a name.

    One that is spelled so comes first, then one that is in another case.

    Raises:
        UnknownNameError: there is none, with the nearest names.
        ArgumentError: there are several in other cases; or the package that has it cannot be
            imported, or has something else.
    """
    if name in _ADAPTERS:
        return _ADAPTERS[name]
    elsewhere = _entry_points()
    if name not in elsewhere:
        return find(_spelled(name, {*_ADAPTERS, *elsewhere}))
    _ADAPTERS[name] = _loaded(name, elsewhere[name])
    return _ADAPTERS[name]


def _spelled(name: str, known: Collection[str]) -> str:
    """How the form is spelled that a program writes in another case.

    Raises:
        UnknownNameError: there is none, with the nearest names.
        ArgumentError: there are several.
    """
    alike = sorted(other for other in known if other.casefold() == name.casefold())
    if len(alike) > 1:
        told = " or ".join(alike)
        raise ArgumentError(f"AS {name} is ambiguous; write AS {told}")
    if not alike:
        raise UnknownNameError(
            f"there is no result form {short_repr(name)}", suggestions=nearest(name, known)
        )
    return alike[0]


def tables_of_forms(names: Iterable[str]) -> frozenset[str]:
    """The tables that forms read beside that of entities; those that are no forms read none."""
    found: frozenset[str] = frozenset()
    for name in names:
        forms = [_ADAPTERS[name]] if name in _ADAPTERS else _alike(name)
        found = found.union(*(form.tables for form in forms))
    return found


def _alike(name: str) -> list[Adapter]:
    folded = name.casefold()
    return [form for known, form in _ADAPTERS.items() if known.casefold() == folded]


def forms() -> list[Adapter]:
    """All forms, ssduck's own first; those of packages that cannot be imported left out."""
    for name in _entry_points().keys() - _ADAPTERS.keys():
        try:
            find(name)
        except ArgumentError:  # whoever asks for it by name is told
            continue
    return list(dict.fromkeys(_ADAPTERS.values()))


def _entry_points() -> dict[str, Any]:
    return {point.name: point for point in entry_points(group=GROUP)}


def _loaded(name: str, point: Any) -> Adapter:
    try:
        found = point.load()
    except Exception as error:
        raise ArgumentError(
            f"AS {name}: {point.value} cannot be loaded: {error_text(error)}"
        ) from error
    if isinstance(found, Adapter):
        return found
    if not callable(found):
        raise ArgumentError(f"AS {name}: {point.value} is no function and no Adapter")
    return Adapter((name,), inspect.getdoc(found) or f"A form of {point.value}.", found)


__all__ = ["Adapter", "Need", "Selection", "adapter", "find", "forms", "tables_of_forms"]
