"""Raw SQL over batches: a query reads tables of all environments in place of those of a tick."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import pyarrow as pa
from sqlglot import exp

from ssduck.database.binding import BoundWorld
from ssduck.database.relation_rewriting import parsed, start_of
from ssduck.database.schemas import with_view_columns
from ssduck.database.statement_names import WorldNames, source_tables
from ssduck.errors import UnsupportedError
from ssduck.recording.stores.history_sql import quoted
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.user_sql import Edit, edited
from ssduck.world.batches.batch_world import BatchWorld

_RELATIONS = {name.lower(): name for name in RELATIONS}
# Returns a table of a batch with the environment of each row, by the batch and the name.
BatchTable: TypeAlias = Callable[[BatchWorld, str], pa.Table]


@dataclass(frozen=True)
class BatchStatement:
    """A query that reads batches.

    Attributes:
        text: its text, in which their tables have names of their own.
        tables: the batch and the table of each of these names.
    """

    text: str
    tables: Mapping[str, tuple[BatchWorld, str]]


def over_batches(
    sql: str, names: WorldNames, worlds: Mapping[str, BoundWorld]
) -> BatchStatement | None:
    """Returns a statement as a query that reads batches; None if it is no such query.

    Raises:
        UnsupportedError: it calls relations.
    """
    tree = parsed(sql)
    edits: list[Edit] = []
    tables: dict[str, tuple[BatchWorld, str]] = {}
    for table in () if tree is None else source_tables(tree):
        live, schema = names.live_table(table), names.schema(table)
        world = worlds[schema].reference() if schema is not None and schema in worlds else None
        start = start_of(table)
        if live is None or schema is None or start is None or not isinstance(world, BatchWorld):
            continue
        name = f"environments of {schema}: {live.name}"
        tables[name] = world, live.name
        rows = with_view_columns(live, f"SELECT * FROM {quoted(name)}", schema)  # noqa: S608
        alias = "" if table.alias else f" AS {quoted(table.name)}"
        edits.append(Edit(start, table.this.meta["end"] + 1, f"({rows}){alias}"))
    if tree is None or not tables:
        return None
    _check_calls(tree)
    return BatchStatement(edited(sql, edits), tables)


def _check_calls(tree: exp.Expr) -> None:
    """Checks that a query calls no relation, which is of the rows of one world."""
    for call in tree.find_all(exp.Anonymous):
        name = _RELATIONS.get(call.name.lower())
        if name is not None:
            raise UnsupportedError(
                f"in raw SQL, {name}(…) is of one world, and this reads a batch: select the rows "
                f'with ss.eval("SELECT env, … WHERE {name}(…) AS arrow;"), and ss.register makes '
                "them a table"
            )
