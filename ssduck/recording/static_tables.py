"""Turns entities into the rows of their models, and back: the columns that no tick changes."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any, Protocol

import numpy as np
import pyarrow as pa

from ssduck.errors import RecordError
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.schema import MODELS, RECORDED
from ssduck.simulators.interface import Body, Joint, Link
from ssduck.simulators.scenes import SensorSpec
from ssduck.world.layout import EntityInfo
from ssduck.world.live_tables import ARROW_TYPES

# The margins, m, of shapes in old records, which lack them: those that PyBullet gave hulls.
UNRECORDED_MARGINS = {"hull": 1e-3}


class ShapeNumbers(Protocol):
    """What numbers entities' run and their geometries: a snapshot of their world."""

    @property
    def run(self) -> int:
        """The number of the run that its ticks are of."""

    def geometry_id(self, geometry: Geometry) -> int:
        """The number of a geometry."""


def model_rows(
    members: Collection[EntityInfo], numbers: ShapeNumbers, known: Collection[int]
) -> dict[str, pa.Table]:
    """The rows of the models of entities, by table.

    Args:
        members: the entities.
        numbers: of their run, and of geometries.
        known: geometries that are stored already.
    """
    rows: dict[str, list[tuple[Any, ...]]] = {table: [] for table in MODELS}
    geometries: dict[int, Geometry] = {}
    for member in members:
        rows["entities"].append((*_member_row(member), numbers.run))
        if member.body is None:
            continue
        for number, link in enumerate(member.body.links):
            parent = link.parent if link.parent >= 0 else None
            rows["links"].append((member.id, number, link.name, parent, link.mass))
        for joint in member.body.joints:
            limits = (joint.lower, joint.upper, joint.max_effort, joint.max_velocity)
            rows["joints"].append(
                (member.id, joint.link, joint.name, joint.type, *limits, *joint.axis)
            )
        for number, shape in enumerate(member.body.shapes):
            id = numbers.geometry_id(shape.geometry)
            geometries[id] = shape.geometry
            pose = (*np.asarray(shape.position).tolist(), *np.asarray(shape.orientation).tolist())
            marks = (shape.margin, shape.exact)
            rows["shapes"].append((member.id, shape.frame, number, id, *pose, *marks))
    rows["geometries"] = [
        (id, g.type, *g.size, g.vertices.tolist(), g.faces.tolist())
        for id, g in geometries.items()
        if id not in known
    ]
    return {table: _table(table, own) for table, own in rows.items()}


def _member_row(member: EntityInfo) -> tuple[Any, ...]:
    body, sensor = member.body, member.sensor
    told = (member.id, member.name, member.kind, member.parent, member.mass)
    if body is not None:
        return (*told, len(body.links), body.movable, None, None, None)
    spec = None if sensor is None else json.dumps(asdict(sensor), sort_keys=True)
    return (*told, 0, None, *member.mount, spec)


def _table(table: str, rows: Sequence[tuple[Any, ...]]) -> pa.Table:
    model = MODELS[table].model
    columns = list(zip(*rows, strict=True)) or [()] * len(model)
    arrays = [
        pa.array(values, ARROW_TYPES[column.type])
        for values, column in zip(columns, model, strict=True)
    ]
    return pa.table(arrays, names=[column.name for column in model])


# -- and back ---------------------------------------------------------------------------------


def members_of(models: Mapping[str, pa.Table]) -> dict[int, EntityInfo]:
    """The entities that rows tell of, by id."""
    geometries = {row["id"]: _geometry(row) for row in models["geometries"].to_pylist()}
    links = _by_entity(models["links"], "link")
    joints = _by_entity(models["joints"], "link")
    shapes = _by_entity(models["shapes"], "shape")
    found = {}
    for row in models["entities"].to_pylist():
        id = row["id"]
        if row["kind"] == "sensor":
            found[id] = _sensor(row)
            continue
        body = Body(
            handle=id,
            name=row["name"],
            kind=row["kind"],
            movable=row["movable"],
            links=tuple(map(_link, links.get(id, ()))),
            joints=tuple(map(_joint, joints.get(id, ()))),
            shapes=tuple(_shape(shape, geometries) for shape in shapes.get(id, ())),
        )
        found[id] = EntityInfo(id, row["name"], row["kind"], row["parent"], body=body)
    return found


def run_of(models: Mapping[str, pa.Table]) -> int | None:
    """The number of the run that rows are of; None where they do not tell, as old records.

    Raises:
        RecordError: they are of several.
    """
    entities = models["entities"]
    if "run" not in entities.column_names:
        return None
    runs = np.unique(entities["run"].to_numpy()).tolist()
    if len(runs) > 1:
        raise RecordError("it is damaged: its entities are of several runs")
    return runs[0] if runs else None


def geometries_of(models: Mapping[str, pa.Table]) -> dict[str, int]:
    """The numbers of geometries that rows tell of, by their keys."""
    return {_geometry(row).key: row["id"] for row in models["geometries"].to_pylist()}


def default_values(run: int | None, geometries: str) -> dict[str, str]:
    """The values of columns that rows of older records lack, in SQL; the others are unknown.

    Args:
        run: the number of the run, of rows that do not tell it.
        geometries: the table of the geometries, in SQL.
    """
    cases = " ".join(
        f"WHEN '{type}' THEN {margin!r}" for type, margin in UNRECORDED_MARGINS.items()
    )
    margin = (
        f"SELECT CASE types.type {cases} ELSE 0 END "  # noqa: S608
        f"FROM {geometries} AS types WHERE types.id = geometry"
    )
    return {"margin": margin} | ({} if run is None else {"run": f"{run:d}"})


def _by_entity(table: pa.Table, key: str) -> dict[int, list[dict[str, Any]]]:
    found: dict[int, list[dict[str, Any]]] = {}
    for row in sorted(table.to_pylist(), key=lambda row: (row["entity"], row[key])):
        found.setdefault(row["entity"], []).append(row)
    return found


def _sensor(row: Mapping[str, Any]) -> EntityInfo:
    told = json.loads(row["sensor"])
    told |= {name: tuple(told[name]) for name in ("position", "orientation")}
    mount = (row["host"], row["host_link"])
    return EntityInfo(
        row["id"], row["name"], "sensor", row["parent"], sensor=SensorSpec(**told), mount=mount
    )


def _link(row: Mapping[str, Any]) -> Link:
    return Link(row["name"], -1 if row["parent"] is None else row["parent"], row["mass"])


def _joint(row: Mapping[str, Any]) -> Joint:
    names = ("name", "type", "link", "lower", "upper", "max_effort", "max_velocity")
    told = {name: row[name] for name in names}
    return Joint(**told, axis=(row["axis_x"], row["axis_y"], row["axis_z"]))


def _shape(row: Mapping[str, Any], geometries: Mapping[int, Geometry]) -> PlacedGeometry:
    position = np.array([row[axis] for axis in ("x", "y", "z")])
    orientation = np.array([row[axis] for axis in ("qw", "qx", "qy", "qz")])
    geometry = geometries[row["geometry"]]
    margin = row["margin"] if "margin" in row else UNRECORDED_MARGINS.get(geometry.type, 0.0)
    return PlacedGeometry(row["link"], geometry, position, orientation, margin, row.get("exact"))


def _geometry(row: Mapping[str, Any]) -> Geometry:
    return Geometry(
        row["type"],
        (row["size_x"], row["size_y"], row["size_z"]),
        np.array(row["vertices"], dtype=np.float64).reshape(-1, 3),
        np.array(row["faces"], dtype=np.int32).reshape(-1, 3),
    )


def with_model(table: str, rows: pa.Table, model: pa.Table, names: Iterable[str]) -> pa.Table:
    """Rows of a tick with what entities are.

    Args:
        table: what the rows are of.
        rows: what differs from tick to tick.
        model: what does not.
        names: the columns that are wanted, in order.
    """
    place = np.searchsorted(*_sorted_keys(table, model, rows))
    order = _order(table, model)
    chosen = pa.array(order[place])
    columns = [
        rows[name] if name in rows.column_names else model[name].take(chosen) for name in names
    ]
    return pa.table(columns, names=list(names))


def _keys(table: str, rows: pa.Table) -> Any:
    """One number a row, by which rows and models belong together."""
    first, *others = (rows[name].to_numpy() for name in RECORDED[table].key)
    return first if not others else first * 2**20 + others[0]


def _order(table: str, model: pa.Table) -> Any:
    return np.argsort(_keys(table, model), kind="stable")


def _sorted_keys(table: str, model: pa.Table, rows: pa.Table) -> tuple[Any, Any]:
    keys = _keys(table, model)
    return keys[_order(table, model)], _keys(table, rows)
