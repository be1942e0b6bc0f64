"""What a page says of an entity: its row, its relations, its links and joints, and its past."""

from __future__ import annotations

from typing import Any

import numpy as np

from ssduck.errors import SelectScriptError, check_known
from ssduck.interpreter.interpreter import Interpreter
from ssduck.schema import TABLES
from ssduck.world.entities import Sensor
from ssduck.world.world import World

# What is told of an entity: the names that a query with the entity's id as its parameter selects.
_PAIRS = (
    "SELECT b.name FROM entities a, entities b WHERE a.id = ? AND a.id <> b.id "
    "AND b.kind <> 'sensor' AND "
)
_RELATIONS = {
    "on it": _PAIRS + """a.kind <> 'sensor' AND "on"(a, b) ORDER BY b.name""",
    "it is on": _PAIRS + """a.kind <> 'sensor' AND "on"(b, a) ORDER BY b.name""",
    "touching it": _PAIRS + "a.kind <> 'sensor' AND touching(a, b) ORDER BY b.name",
}
_NEAREST = (
    "SELECT b.name, clearance(a, b) AS gap FROM entities a, entities b WHERE a.id = ? "
    "AND a.id <> b.id AND a.kind <> 'sensor' AND b.kind <> 'sensor' AND distance(a, b) <= "
    "(SELECT max(d) FROM (SELECT distance(c, e) AS d FROM entities c, entities e WHERE c.id = ? "
    "AND c.id <> e.id AND e.kind <> 'sensor' ORDER BY d LIMIT 8)) ORDER BY gap, b.name LIMIT 5"
)
_LINKS = "SELECT name, x, y, z FROM links WHERE entity = ? ORDER BY link"
_JOINTS = (
    "SELECT name, type, position, velocity, lower, upper FROM joints WHERE entity = ? "
    "ORDER BY joint"
)
# The columns whose past is plotted, with the queries.
_COLUMNS = tuple(c for c in TABLES["entities"].tick_columns.doubles if c != "time")
_PLOTS = {
    column: f'SELECT time, "{column}" FROM entities_history WHERE id = ? ORDER BY tick'  # noqa: S608
    for column in _COLUMNS
} | {
    "speed": "SELECT time, sqrt(vx * vx + vy * vy + vz * vz) FROM entities_history WHERE id = ? "
    "ORDER BY tick"
}
_JOINT_PLOT = (
    "SELECT time, position FROM joints_history WHERE entity = ? AND name = ? ORDER BY tick"
)
# A plot has about so many points; of more, the least and the greatest of each bin are kept.
MAX_POINTS = 1500


def facts_of(ss: Interpreter, world: World, id: int) -> dict[str, Any]:
    """Returns what is told of an entity."""
    entity = world.entity(id)
    facts: dict[str, Any] = {"kind": entity.kind, "id": entity.id}
    facts["position (m)"] = _rounded(entity.position)
    facts["orientation (w, x, y, z)"] = _rounded(entity.orientation)
    if isinstance(entity, Sensor):
        return {"name": entity.name, "facts": facts, "relations": {}, "links": [], "joints": []}
    velocity = _rounded(entity.velocity)
    if np.isfinite(velocity).all():  # poses from elsewhere may lack it
        facts["velocity (m/s, rad/s)"] = velocity
    facts["mass (kg)"] = round(entity.mass, 4)
    relations: dict[str, list[list[Any]]] = {
        title: [[name, None] for (name,) in ss.sql(query, [id])]
        for title, query in _RELATIONS.items()
    }
    relations["nearest"] = [[name, gap] for name, gap in ss.sql(_NEAREST, [id, id])]
    links = [[name, *_rounded(place)] for name, *place in ss.sql(_LINKS, [id])]
    return {
        "name": entity.name,
        "facts": facts,
        "relations": relations,
        "links": links,
        "joints": _joints(ss, id),
        "columns": [*_COLUMNS, "speed"],
    }


def _joints(ss: Interpreter, id: int) -> list[list[Any]]:
    """Returns name, type, position, velocity and limits of the joints, as far as recorded."""
    try:
        return [list(row) for row in ss.sql(_JOINTS, [id])]
    except SelectScriptError:  # the record has no joints
        return []


def plot_of(ss: Interpreter, id: int, column: str, joint: str | None) -> dict[str, Any]:
    """Returns times (s) and values of a column of an entity at the recorded ticks."""
    if joint is None:
        check_known(column, _PLOTS, f"there is no plot of {column!r}")
    rows = ss.sql(_PLOTS[column], [id]) if joint is None else ss.sql(_JOINT_PLOT, [id, joint])
    points = np.array([(t, np.nan if v is None else v) for t, v in rows]).reshape(-1, 2)
    return {
        "points": [
            [time, value if np.isfinite(value) else None] for time, value in _thinned(points)
        ]
    }


def _thinned(points: Any) -> list[list[float]]:
    """Returns a part of many points, with the extreme ones."""
    if len(points) > MAX_POINTS:
        chosen = {0, len(points) - 1}
        for part in np.array_split(np.arange(len(points)), MAX_POINTS // 2):
            values = np.nan_to_num(points[part, 1])
            chosen |= {int(part[np.argmin(values)]), int(part[np.argmax(values)])}
        points = points[sorted(chosen)]
    thinned: list[list[float]] = points.tolist()
    return thinned


def _rounded(values: Any) -> list[float]:
    return [round(float(value), 4) for value in values]
