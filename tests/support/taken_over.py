"""A zygote whose workers run Python of a test, as if a stranger had taken them over.

`main` is what its process runs. `HookedZygote` starts it; it can take effects away from its workers.
"""

from __future__ import annotations

from typing import Any

from ssduck.sandbox.processes import WorkerProcess, Zygote
from ssduck.sandbox.seal import Walls


class HookedZygote(Zygote):
    """A zygote of `main`.

    Attributes:
        without: the effects that its next workers lack.
    """

    def __init__(self) -> None:
        super().__init__(__name__)
        self.without: tuple[str, ...] = ()

    def worker(self, walls: Walls, order: dict[str, Any]) -> WorkerProcess:
        return super().worker(walls, {**order, "without": self.without})


def main() -> None:
    from ssduck.sandbox import worker, zygote

    held: dict[str, int] = {}

    def python(own: Any, code: str) -> Any:
        names = {"worker": own, "ss": own._opened.get("ss"), "connection": held["connection"]}
        if "\n" not in code:
            return eval(code, names)  # noqa: S307
        exec(code, names)  # noqa: S102
        return names.get("result")

    worker.Worker.python = python  # type: ignore[attr-defined]

    def serve(connection: int, walls: Walls, order: dict[str, Any]) -> None:
        held["connection"] = connection
        worker.serve(connection, walls, order, order.get("without", ()))

    zygote.run(serve)
