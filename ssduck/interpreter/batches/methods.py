"""The methods of an interpreter on batches: `BatchMethods`."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, cast

from ssduck.interpreter.execution import Execution
from ssduck.language.tree import Node
from ssduck.lazy import service
from ssduck.world.batches.batch_world import BatchWorld

if TYPE_CHECKING:
    from ssduck.interpreter.batches.evaluator import BatchExpressions
    from ssduck.interpreter.batches.programs import BatchPrograms


class BatchTerms(Protocol):
    """The terms that `BatchMethods.terms` returns; see `ssduck.gym.BatchTerms`."""

    def __call__(self) -> Any:
        """Returns the values of the terms at the last tick."""


class BatchMethods:
    """The methods on batches, for an interpreter that has programs."""

    _execution: Execution
    _lock: threading.RLock
    # The programs over batches, from the first batch on.
    _batches: BatchPrograms | None = None

    def _begin_batches(self) -> None:
        """Prepares for programs over batches."""
        from ssduck.interpreter.batches.programs import BatchPrograms

        if self._batches is None:
            self._batches = BatchPrograms(self._execution)
        self._batches.forget()

    def terms(
        self,
        success: str | None = None,
        failure: str | None = None,
        reward: str | Mapping[str, str] | None = None,
        stop_when: str | None = None,
        **options: Any,
    ) -> BatchTerms:
        """Returns the terms of a task over a batch: a call has their values in all environments.

        The arguments, `world` and `nan` among them, are those of `ssduck.gym.BatchTerms`.
        """
        made = service("terms")(self, success, failure, reward, stop_when, **options)
        return cast("BatchTerms", made)

    def over_batch(self, nodes: Sequence[Node], world: BatchWorld) -> BatchExpressions:
        """Returns parsed expressions as a function of all environments; `terms` are made of it."""
        assert self._batches is not None, "a batch is bound"
        with self._lock:
            self._execution.begin_program()
            return self._batches.terms(nodes, world)
