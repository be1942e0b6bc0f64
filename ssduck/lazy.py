"""Lets packages export names that are imported on first use.

Importing a module imports the packages around it. With `exports`, a package declares its public
names, and the import of their modules waits until they are used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any


def exports(
    package: str, names: Mapping[str, Sequence[str]]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Returns the functions `__getattr__` and `__dir__` of a package.

    Args:
        package: the name of the package.
        names: the public names by the submodule that defines them.

    >>> get, names = exports("ssduck", {"limits": ("Limits",), "errors": ("ParseError",)})
    >>> names()
    ['Limits', 'ParseError']
    >>> get("Limits").__module__
    'ssduck.limits'
    """
    modules = {name: module for module, exported in names.items() for name in exported}

    def get(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{modules[name]}"), name)

    return get, lambda: sorted(modules)
