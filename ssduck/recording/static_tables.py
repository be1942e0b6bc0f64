"""Converts entities to the rows of their models and back: the columns that no tick changes."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import pyarrow as pa

from ssduck.errors import RecordError
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.schema import MODELS, POSE, RECORDED, TABLES
from ssduck.simulators.interface import Body, Joint, Link
from ssduck.simulators.scenes import SensorSpec
from ssduck.world.layout import EntityInfo
from ssduck.world.live_tables import ARROW_TYPES
from ssduck.world.rows import geometry_columns, joint_columns, link_columns, shape_columns
from ssduck.world.snapshot import Snapshot


def model_rows(
    members: Collection[EntityInfo],
    snapshot: Snapshot,
    stored: Collection[int],
    *,
    with_visuals: bool = True,
) -> dict[str, pa.Table]:
    """Returns the rows of the models of entities, by table.

    Args:
        members: the entities.
        snapshot: gives the numbers of their run and of their geometries.
        stored: the numbers of geometries that are stored already.
        with_visuals: whether they say what is drawn; the simulator of a record in memory does.
    """
    number_of = snapshot.geometry_id
    visuals = [_visuals(m.body, snapshot) if with_visuals else None for m in members]
    drawn = {number_of(v.geometry): v.geometry for of_body in visuals for v in of_body or ()}
    texts = [None if of_body is None else _visuals_text(of_body, number_of) for of_body in visuals]
    rows = [
        (*_member_row(member), text, snapshot.run)
        for member, text in zip(members, texts, strict=True)
    ]
    bodies = [(member.id, member.body) for member in members if member.body is not None]
    (_, links), (_, joints) = link_columns(bodies), joint_columns(bodies)
    (_, shapes), geometries = shape_columns(bodies, number_of)
    new = {id: one for id, one in (drawn | geometries).items() if id not in stored}
    moving = [joint for _, body in bodies for joint in body.joints]
    placed = [(*shape.position, *shape.orientation) for _, b in bodies for shape in b.shapes]
    columns: dict[str, Mapping[str, Sequence[Any]]] = {
        "entities": _by_column([column.name for column in MODELS["entities"].model], rows),
        "links": links,
        "joints": joints
        | _by_column([f"axis_{axis}" for axis in "xyz"], [joint.axis for joint in moving])
        | _by_column([f"anchor_{axis}" for axis in "xyz"], [joint.anchor for joint in moving])
        | {"reference": [joint.reference for joint in moving]},
        "shapes": shapes | _by_column(POSE, placed),
        "geometries": geometry_columns(new)[1],
    }
    return {
        name: pa.table(
            {c.name: pa.array(columns[name][c.name], ARROW_TYPES[c.type]) for c in table.model}
        )
        for name, table in MODELS.items()
    }


def _by_column(names: Sequence[str], rows: Sequence[Sequence[Any]]) -> dict[str, Sequence[Any]]:
    return {name: [row[place] for row in rows] for place, name in enumerate(names)}


def _visuals(body: Body | None, snapshot: Snapshot) -> Sequence[PlacedGeometry] | None:
    """Returns what is drawn of an entity; None if that is not known."""
    if body is None or snapshot.drawn is None:
        return None if body is None else body.visuals
    return snapshot.drawn(body)


def _member_row(member: EntityInfo) -> tuple[Any, ...]:
    body, sensor = member.body, member.sensor
    common = (member.id, member.name, member.kind, member.parent, member.mass)
    if body is not None:
        return (*common, len(body.links), len(body.joints), body.movable, None, None, None)
    spec = None if sensor is None else json.dumps(asdict(sensor), sort_keys=True)
    return (*common, 0, 0, None, *member.mount, spec)


def _visuals_text(visuals: Sequence[PlacedGeometry], geometry_id: Callable[[Geometry], int]) -> str:
    """Returns visual shapes as JSON: a list of their numbers.

    These are link, geometry, x y z, qw qx qy qz in the frame of the link, and red, green, blue,
    alpha from 0 to 1, which a shape without a colour lacks.
    """
    rows = [
        [
            visual.frame,
            geometry_id(visual.geometry),
            *np.asarray(visual.position, dtype=float).tolist(),
            *np.asarray(visual.orientation, dtype=float).tolist(),
            *_shares(visual.colour),
        ]
        for visual in visuals
    ]
    return json.dumps(rows, separators=(",", ":"))


def _shares(colour: Sequence[float] | None) -> list[float]:
    """Returns the shares of a colour; none of one that is not finite, which nothing can draw."""
    shares = np.clip(colour or (), 0.0, 1.0)
    return shares.tolist() if np.isfinite(shares).all() else []


# -- from rows to entities --------------------------------------------------------------------


def members_of(models: Mapping[str, pa.Table]) -> dict[int, EntityInfo]:
    """Returns the entities of the rows of models, by id."""
    geometries = {row["id"]: _geometry(row) for row in models["geometries"].to_pylist()}
    links = _by_entity(models["links"], "link")
    joints = _by_entity(models["joints"], "link", "joint")
    shapes = _by_entity(models["shapes"], "shape")
    members = {}
    for row in models["entities"].to_pylist():
        id = row["id"]
        if row["kind"] == "sensor":
            members[id] = _sensor(row)
            continue
        body = Body(
            handle=id,
            name=row["name"],
            kind=row["kind"],
            movable=row["movable"],
            links=tuple(map(_link, links.get(id, ()))),
            joints=tuple(map(_joint, joints.get(id, ()))),
            shapes=tuple(_shape(shape, geometries) for shape in shapes.get(id, ())),
            visuals=_visuals_of(row["visuals"], geometries),
        )
        members[id] = EntityInfo(id, row["name"], row["kind"], row["parent"], body=body)
    return members


def run_of(models: Mapping[str, pa.Table]) -> int | None:
    """Returns the number of the run of the rows of models; None if there are no entities."""
    runs = np.unique(models["entities"]["run"].to_numpy()).tolist()
    if len(runs) > 1:
        raise RecordError("it is damaged: its entities are of several runs")
    return runs[0] if runs else None


def geometries_of(models: Mapping[str, pa.Table]) -> dict[str, int]:
    """Returns the numbers of the geometries of the rows of models, by their keys."""
    return {_geometry(row).key: row["id"] for row in models["geometries"].to_pylist()}


def _by_entity(table: pa.Table, *keys: str) -> dict[int, list[dict[str, Any]]]:
    """Returns the rows of each entity, sorted by the keys."""
    rows: dict[int, list[dict[str, Any]]] = {}
    for row in sorted(table.to_pylist(), key=lambda row: [row[key] for key in keys]):
        rows.setdefault(row["entity"], []).append(row)
    return rows


def _visuals_of(
    text: str | None, geometries: Mapping[int, Geometry]
) -> tuple[PlacedGeometry, ...] | None:
    """Returns the visual shapes of a text of a record; None if they are unknown."""
    if text is None:
        return None
    return tuple(
        PlacedGeometry(
            row[0],
            geometries[row[1]],
            np.array(row[2:5], dtype=float),
            np.array(row[5:9], dtype=float),
            colour=tuple(row[9:]) or None,
        )
        for row in json.loads(text)
    )


def _sensor(row: Mapping[str, Any]) -> EntityInfo:
    values = json.loads(row["sensor"])
    values |= {name: tuple(values[name]) for name in ("position", "orientation")}
    mount = (row["host"], row["host_link"])
    return EntityInfo(
        row["id"], row["name"], "sensor", row["parent"], sensor=SensorSpec(**values), mount=mount
    )


def _link(row: Mapping[str, Any]) -> Link:
    parent, type = row["parent"], row["region"]
    region = None
    if type is not None:
        region = Geometry.primitive(type, [row[f"region_{axis}"] for axis in "xyz"])
    return Link(row["name"], -1 if parent is None else parent, row["mass"], region)


def _joint(row: Mapping[str, Any]) -> Joint:
    names = ("name", "type", "link", "lower", "upper", "max_effort", "max_velocity")
    values = {name: row[name] for name in names}
    axis = (row["axis_x"], row["axis_y"], row["axis_z"])
    anchor = (row["anchor_x"], row["anchor_y"], row["anchor_z"])
    return Joint(**values, axis=axis, anchor=anchor, reference=row["reference"])


def _shape(row: Mapping[str, Any], geometries: Mapping[int, Geometry]) -> PlacedGeometry:
    position = np.array([row[axis] for axis in ("x", "y", "z")])
    orientation = np.array([row[axis] for axis in ("qw", "qx", "qy", "qz")])
    geometry, details = geometries[row["geometry"]], (row["margin"], row["exact"])
    return PlacedGeometry(row["link"], geometry, position, orientation, *details)


def _geometry(row: Mapping[str, Any]) -> Geometry:
    vertices = np.array(row["vertices"], dtype=np.float64).reshape(-1, 3)
    faces = np.array(row["faces"], dtype=np.int32).reshape(-1, 3)
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices):  # FCL would crash
        raise RecordError(f"the geometry {row['id']} has a face that refers to a missing vertex")
    size = (row["size_x"], row["size_y"], row["size_z"])
    return Geometry(row["type"], size, vertices, faces)


def join_model(table: str, rows: pa.Table, model: pa.Table, names: Iterable[str]) -> pa.Table:
    """Joins the rows of ticks with the model of their table.

    Raises:
        RecordError: a row is of an entity without a model.
    """
    known, keys = _keys(table, model), _keys(table, rows)
    order = np.argsort(known, kind="stable")
    place = np.searchsorted(known, keys, sorter=order)
    is_known = len(known) > 0 and (known[order].take(place, mode="clip") == keys).all()
    if len(keys) and not is_known:
        raise RecordError(f"a row of {table} is of an unknown entity, or an unknown part of one")
    model_rows = pa.array(order[place])

    def column(name: str) -> Any:
        if name in rows.column_names:
            return rows[name]
        return model[name].take(model_rows)

    return pa.table(list(map(column, names)), names=list(names))


def _keys(table: str, rows: pa.Table) -> Any:
    """Returns one integer a row, by which rows and models are joined."""
    first, *others = (rows[name].to_numpy() for name in RECORDED[table].key)
    return first if not others else first * 2**20 + others[0]


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
