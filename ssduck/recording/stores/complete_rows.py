"""Gives the rows of ticks all columns of their tables, from the models of the entities."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from ssduck.recording.static_tables import join_model
from ssduck.schema import TABLES


def complete_rows(
    table: str, rows: pa.Table, entities: pa.Table, models: Mapping[str, pa.Table]
) -> pa.Table:
    """Returns rows with all columns of their table, as the parts of a folder have them.

    Args:
        table: the name of the table.
        rows: the columns that differ from tick to tick.
        entities: the same of the entities, at the same ticks.
        models: the rows of each model.
    """
    if table not in TABLES:  # the poses of links are internal
        return rows
    names = TABLES[table].names
    if not TABLES[table].model:
        return rows.select(names)
    if table == "links":
        single = _links_of_single_link_bodies(rows, entities, models["entities"])
        rows = _sorted_links(pa.concat_tables([rows, single]))
    for name in TABLES[table].tick_columns.booleans:
        place = rows.column_names.index(name)
        rows = rows.set_column(place, name, rows[name].cast(pa.bool_()))
    return join_model(table, rows, models[table], names)


def _links_of_single_link_bodies(links: pa.Table, entities: pa.Table, model: pa.Table) -> pa.Table:
    """Returns the rows of the links of bodies with one link, which has the pose of the body."""
    single = model.filter(pa.array(model["links"].to_numpy() == 1))["id"].to_numpy()
    bodies = entities.filter(pa.array(np.isin(entities["id"].to_numpy(), single)))
    number = pa.array(np.zeros(bodies.num_rows, dtype=np.int64))
    renamed = bodies.rename_columns({"id": "entity"}).append_column("link", number)
    return renamed.select(links.column_names)


def _sorted_links(links: pa.Table) -> pa.Table:
    """Returns rows of links sorted by tick, entity and link, so that sums are reproducible."""
    keys = [links[name].to_numpy() for name in ("link", "entity", "tick")]
    return links.take(np.lexsort(keys))
