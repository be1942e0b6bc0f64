"""Runs programs over a batch: an expression, or a query whose rows are environments or entities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

from ssduck.errors import UnsupportedError
from ssduck.interpreter.batches.evaluator import BatchExpressions, without_unknown
from ssduck.interpreter.batches.expressions import Engine
from ssduck.interpreter.batches.queries import BatchQuery
from ssduck.interpreter.execution import Execution
from ssduck.language.analysis import calls_of, variables_of
from ssduck.language.tree import Node, Program, Query
from ssduck.world.batches.batch_world import BatchWorld
from ssduck.world.handles import Handle


class BatchPrograms:
    """Programs over batches, compiled when they are evaluated first."""

    def __init__(self, execution: Execution) -> None:
        self._execution = execution
        # By the schemas of their batches.
        self._engines: dict[str, Engine] = {}
        self._compiled: WeakKeyDictionary[Program, _Compiled] = WeakKeyDictionary()

    def batch_of(self, program: Program) -> BatchWorld | None:
        """Returns the batch that a program reads; None if it reads none."""
        names = frozenset().union(*map(variables_of, program.statements))
        values = [self._execution.variable_or_none(name) for name in names]
        if any("getTime" in calls_of(statement) for statement in program.statements):
            values += self._execution.worlds[:1]  # whose time it is
        values = [value.world if isinstance(value, Handle) else value for value in values]
        batches = list({id(v): v for v in values if isinstance(v, BatchWorld)}.values())
        if len(batches) > 1:
            raise UnsupportedError("a program reads one batch: evaluate one for each")
        return batches[0] if batches else None

    def value(self, program: Program, world: BatchWorld) -> Any:
        """Returns the value of a program over a batch."""
        execution = self._execution
        with execution.transaction(program), world.lock:
            if program.explain:
                with world.at(0):
                    return execution.explanation(program)
            compiled = self._compiled.get(program)
            if compiled is None or not compiled.is_current(execution):
                compiled = self._compiled[program] = self._made(program, world)
            if isinstance(compiled.value, BatchQuery):
                return compiled.value.value()
            (answers,) = compiled.value.answers()
            return world.given_back(without_unknown(answers, repr(program.text.strip())))

    def terms(self, nodes: Sequence[Node], world: BatchWorld) -> BatchExpressions:
        """Returns expressions over all environments of a batch, checked in one."""
        expressions = BatchExpressions(self._execution, self._engine_of(world), nodes)
        expressions.check()
        return expressions

    def report(self, program: Program, world: BatchWorld) -> None:
        """Reports the probable mistakes in an expression or a query over a batch."""
        (node,) = self._execution.read(program).statements
        with world.at(0):
            self._execution.report(self._execution.mistakes(program.text, node))

    def forget(self) -> None:
        """Forgets compiled programs: a name means another batch."""
        self._engines.clear()
        self._compiled.clear()

    def _engine_of(self, world: BatchWorld) -> Engine:
        schema = self._execution.database.schema_of(world)
        engine = self._engines.get(schema)
        if engine is None or engine.world is not world:
            engine = self._engines[schema] = Engine(world, schema)
        return engine

    def _made(self, program: Program, world: BatchWorld) -> _Compiled:
        """Compiles a program, which has to be one expression or query."""
        execution = self._execution
        read = execution.read(program)
        if len(read.statements) != 1:
            raise UnsupportedError(
                "over a batch, a program is one expression or query: set variables with "
                "add_variable"
            )
        (node,) = read.statements
        self.report(program, world)
        value: BatchQuery | BatchExpressions
        if isinstance(node, Query):
            value = BatchQuery(execution, self._engine_of(world), node)
        else:
            value = self.terms([node], world)
        return _Compiled(value, execution.planner.generation)


@dataclass(frozen=True)
class _Compiled:
    """A compiled program, and the object that is replaced when names get other meanings."""

    value: BatchExpressions | BatchQuery
    generation: object

    def is_current(self, execution: Execution) -> bool:
        """Checks whether names have the same meaning."""
        is_same = self.generation is execution.planner.generation
        return is_same and self.value.has_same_arrays()
