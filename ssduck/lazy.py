"""Imports modules on first use: those of a package's names, libraries, and services.

Importing a module also imports its parent packages; lazy exports keep this cheap.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any

# The environment in which libraries start no threads when they are imported.
ONE_THREAD = {
    **dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    "JE_ARROW_MALLOC_CONF": "background_thread:false",
}


def exports(
    package: str, names: Mapping[str, Sequence[str]]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Returns the functions `__getattr__` and `__dir__` of a package.

    Args:
        package: the name of the package.
        names: its public names, by the module of the package that defines them.
    """
    modules = {name: module for module, exported in names.items() for name in exported}

    def get(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{modules[name]}"), name)

    return get, lambda: sorted(modules)


# The functions by which higher layers serve lower ones, by name: `module:function`.
_SERVICES: dict[str, str] = {}


def offer(service: str, target: str) -> None:
    """Offers a function of a higher layer to lower ones.

    Args:
        service: the name by which they ask for it.
        target: its module and its name, as `package.module:function`.
    """
    _SERVICES[service] = target


def service(name: str) -> Callable[..., Any]:
    """Returns the function that is offered under a name; its module is imported now."""
    module, _, function = _SERVICES[name].partition(":")
    offered: Callable[..., Any] = getattr(import_module(module), function)
    return offered


def import_whole(name: str) -> None:
    """Imports a library; Ctrl-C waits until that is done.

    trimesh catches every exception of what it imports itself, KeyboardInterrupt as well, and lacks
    that part from then on.

    Raises:
        KeyboardInterrupt: Ctrl-C was pressed meanwhile; the library is imported.
    """
    handler = signal.getsignal(signal.SIGINT)
    is_main = threading.current_thread() is threading.main_thread()
    if name in sys.modules or not is_main or not callable(handler):
        import_module(name)
        return
    pressed: list[tuple[int, Any]] = []
    signal.signal(signal.SIGINT, lambda *given: pressed.append(given))
    try:
        import_module(name)
    finally:
        signal.signal(signal.SIGINT, handler)
        if pressed:
            handler(*pressed[0])
