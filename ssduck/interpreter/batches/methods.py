"""The batches of an interpreter: programs over them, and their history as a record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

from ssduck.errors import ArgumentError
from ssduck.formatting import joined_names
from ssduck.interpreter.execution import Execution
from ssduck.language import ast
from ssduck.lazy import service
from ssduck.world.batches.batch_world import BatchWorld

if TYPE_CHECKING:
    from ssduck.interpreter.batches.evaluator import BatchExpressions
    from ssduck.interpreter.batches.queries import BatchPrograms


class BatchTerms(Protocol):
    """The terms that `Interpreter.terms` returns; see `ssduck.gym.BatchTerms`."""

    def __call__(self) -> Any:
        """Returns the values of the terms at the last tick."""


class Batches:
    """The batches of an interpreter: its methods on them, and its programs over them."""

    def __init__(self, execution: Execution) -> None:
        self._execution = execution
        # The programs over batches, from the first batch on.
        self.programs: BatchPrograms | None = None

    def begin(self) -> None:
        """Prepares for programs over batches, one of which was bound to a variable."""
        from ssduck.interpreter.batches.columns import batch_table
        from ssduck.interpreter.batches.queries import BatchPrograms

        if self.programs is None:
            self.programs = BatchPrograms(self._execution)
            self._execution.database.raw_sql.batch_table = batch_table
        self.programs.forget()

    def export_batch(
        self,
        path: str | Path,
        world: str | BatchWorld | None = None,
        environments: Any = None,
        *,
        tags: Mapping[str, Any] | None = None,
    ) -> list[int]:
        """Writes the history of a batch to a folder of Parquet files, for `ssduck.lake`.

        Each episode of an environment is one of the record, from a reset to the next one. Contacts
        are written if the states of all its ticks have them.

        Args:
            path: the folder; it is made if it does not exist, and may hold other episodes.
            world: the batch, made with `World.batch(…, history=…)`, or the name of its variable;
                None for the only one.
            environments: the numbers of the environments, or a mask (n,) of True and False; None
                for all.
            tags: what you say of the episodes, by name: a value, or an array (n,) with one for each
                environment. Each has the tag `environment`, too, its number.

        Returns:
            The numbers of the episodes there, environment after environment.

        Raises:
            ArgumentError: the world is no batch, keeps no ticks or has no simulated times, or there
                is no such environment.
            RecordError: the folder holds other files, or cannot be written.
        """
        with self._execution.lock:
            written = service("export batch")(self._batch(world), path, environments, tags)
        return cast("list[int]", written)

    def _batch(self, world: str | BatchWorld | None) -> BatchWorld:
        """Returns a batch of the interpreter, by its name; the only one for None."""
        worlds = self._execution.worlds
        batches = [one for one in worlds if isinstance(one, BatchWorld)]
        found = batches if world is None else [b for b in batches if world in (b, b.name)]
        if len(found) != 1:
            known = joined_names([batch.name for batch in batches]) or "none"
            raise ArgumentError(f"name a batch of this interpreter, of which there are: {known}")
        return found[0]

    def over_batch(
        self, nodes: Sequence[ast.Node], world: BatchWorld, program: ast.Program | None = None
    ) -> BatchExpressions:
        """Returns parsed expressions as a function of all environments; `terms` are made of it.

        Probable mistakes in the program that an expression is are reported, if that is given.
        """
        assert self.programs is not None, "a batch is bound"
        with self._execution.lock:
            self._execution.begin_program()
            expressions = self.programs.terms(nodes, world)
            if program is not None:
                self.programs.report(program, world)
            return expressions
