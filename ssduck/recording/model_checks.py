"""Checks the models of a record's entities: their values, and how their tables refer to each other.

A record may come from a stranger, and what is wrong in a model would fail anywhere later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NoReturn, get_args

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.errors import RecordError, SceneError
from ssduck.formatting import short_repr
from ssduck.geometry.shapes import GeometryType
from ssduck.recording.recorded_visuals import check_visuals
from ssduck.recording.stores.descriptions import parse_description
from ssduck.schema import LINK_FACTOR
from ssduck.simulators.interface import JointType, Kind
from ssduck.simulators.scenes import read_sensor

Array = npt.NDArray[Any]

_REGION = ("region", "region_x", "region_y", "region_z")
# The columns that may be unknown.
_OPTIONAL = {
    "entities": {"parent", "movable", "host", "host_link", "sensor", "visuals"},
    "links": {"parent", *_REGION},
    "joints": {"lower", "upper", "max_effort", "max_velocity"},
    "shapes": {"exact"},
    "geometries": set[str](),
}
# The columns that are finite numbers.
_FINITE = {
    "joints": ("axis_x", "axis_y", "axis_z", "anchor_x", "anchor_y", "anchor_z", "reference"),
    "shapes": ("x", "y", "z", "qw", "qx", "qy", "qz", "margin"),
    "geometries": ("size_x", "size_y", "size_z"),
}
_PRIMITIVES = frozenset(get_args(GeometryType)) - {"hull", "mesh"}
# A shorter quaternion is no rotation.
_SHORTEST = 1e-6


def check_models(models: Mapping[str, pa.Table], place: Callable[[str], str]) -> None:
    """Checks the rows of the models of entities, whose columns have the right types."""
    checks = {
        "entities": _check_entities,
        "geometries": _check_geometries,
        "links": _check_links,
        "joints": _check_joints,
        "shapes": _check_shapes,
    }
    for table, check in checks.items():
        try:
            _check_values(table, models[table])
            check(models)
        except _ModelError as error:
            raise RecordError(f"{place(table)} is damaged: {error}") from error


class _ModelError(Exception):
    """A reason why a model is damaged."""


def _fail(reason: str) -> NoReturn:
    raise _ModelError(reason)


def _check_values(table: str, rows: pa.Table) -> None:
    """Checks that values are known, and finite where they are to be."""
    for name in rows.column_names:
        if name not in _OPTIONAL[table] and rows[name].null_count:
            _fail(f"its column {name!r} lacks a value")
    for name in _FINITE.get(table, ()):
        if not np.isfinite(rows[name].to_numpy()).all():
            _fail(f"its column {name!r} has a number that is not finite")


def _check_entities(models: Mapping[str, pa.Table]) -> None:
    rows = models["entities"]
    _check_unique("id", rows["id"].to_numpy(), 1, LINK_FACTOR)
    kinds = rows["kind"].to_pylist()
    _check_known("kind", kinds, get_args(Kind))
    if not all(rows["name"].to_pylist()):
        _fail("an entity has no name")
    links = _link_counts(rows)
    geometries = frozenset(models["geometries"]["id"].to_pylist())
    drawn: dict[tuple[str, int], None] = {}  # most bodies look like others
    for row in rows.to_pylist():
        if row["kind"] == "sensor":
            _check_sensor(row, links)
        elif row["movable"] is None:
            _fail(f"it is unknown whether the body {short_repr(row['name'])} can move")
        elif row["visuals"] is not None:
            drawn[row["visuals"], links[row["id"]]] = None
    for text, count in drawn:
        _check_visuals(text, count, geometries)


def _check_visuals(text: str, links: int, geometries: frozenset[int]) -> None:
    try:
        check_visuals(text, links, geometries)
    except RecordError as error:
        _fail(error.message)


def _check_sensor(row: Mapping[str, Any], links: Mapping[int, int]) -> None:
    name = short_repr(row["name"])
    link, count = row["host_link"], links.get(row["host"])
    if count is None or link is None or not 0 <= link < count:
        _fail(f"the sensor {name} is mounted on an unknown link")
    if row["parent"] is None or row["sensor"] is None:
        _fail(f"the sensor {name} lacks its specification")
    try:
        values = parse_description(row["sensor"], f"the sensor {name}")
        settings = values.pop("settings")
        on = values.get("on")
        if values.pop("powered") not in (True, False) or not isinstance(on, str):
            _fail(f"the sensor {name} has no valid specification")
        if values["link"] is None:
            del values["link"]
        if not values["max_range"]:
            del values["max_range"]
        read_sensor({**values, **dict(settings)}, (on,))
    except (KeyError, TypeError, ValueError, RecordError) as error:  # a SceneError is a ValueError
        reason = (
            error.message if isinstance(error, SceneError | RecordError) else "values are missing"
        )
        _fail(f"the sensor {name} has no valid specification: {reason}")


def _check_geometries(models: Mapping[str, pa.Table]) -> None:
    rows = models["geometries"]
    _check_unique("id", rows["id"].to_numpy(), 0, 1 << 53)
    _check_known("type", rows["type"].to_pylist(), get_args(GeometryType))
    sizes = np.column_stack([rows[name].to_numpy() for name in _FINITE["geometries"]])
    for number, type in enumerate(rows["type"].to_pylist()):
        corners = _points(rows["vertices"][number], "vertices")
        faces = _points(rows["faces"][number], "faces")
        if not np.isfinite(corners).all():
            _fail("a vertex is no finite number")
        if len(faces) and not 0 <= faces.min() <= faces.max() < len(corners):
            _fail("a face refers to a missing vertex")
        if type in _PRIMITIVES and (len(corners) or len(faces)):
            _fail(f"a {type} has vertices")
        if type not in _PRIMITIVES and not len(faces if type == "mesh" else corners):
            _fail(f"a {type} has no {'faces' if type == 'mesh' else 'vertices'}")
        if type == "plane" and not np.linalg.norm(sizes[number]) > _SHORTEST:
            _fail("a plane has no normal")
        if type != "plane" and sizes[number].min() < 0.0:
            _fail(f"a {type} has a negative size")
        if type == "ellipsoid" and not sizes[number].min() > 0.0:
            _fail("an ellipsoid has no volume")


def _points(value: pa.Scalar, name: str) -> Array:
    """Returns the points of a geometry, (n, 3)."""
    points = value.values.flatten() if value.is_valid else value.values
    if points is None or value.values.null_count or points.null_count:
        _fail(f"a geometry lacks a number of its {name}")
    array: Array = points.to_numpy(zero_copy_only=False).reshape(-1, 3)
    return array


def _check_links(models: Mapping[str, pa.Table]) -> None:
    rows = models["links"]
    counts = _link_counts(models["entities"])
    _check_numbers("links", rows, "link", counts, first=0)
    parents = rows["parent"].fill_null(-1).to_numpy()
    numbers = rows["link"].to_numpy()
    if not ((parents >= -1) & (parents < numbers)).all() or (parents[numbers > 0] < 0).any():
        _fail("the parent of a link does not come before it")
    for region, *size in zip(*(rows[name].to_pylist() for name in _REGION), strict=True):
        _check_region(region, size)


def _check_region(region: str | None, size: list[float | None]) -> None:
    """Checks the region of a site; None for another link."""
    if region is None:
        return
    _check_known("region", [region], tuple(_PRIMITIVES - {"plane"}))
    if any(number is None or not 0.0 <= number < np.inf for number in size):
        _fail("the size of a site's region is no number from 0 up")


def _check_joints(models: Mapping[str, pa.Table]) -> None:
    rows = models["joints"]
    _check_numbers("joints", rows, "joint", _joint_counts(models["entities"]), first=0)
    _check_links_of("joints", rows, _link_counts(models["entities"]))
    _check_known("type", rows["type"].to_pylist(), get_args(JointType))


def _check_shapes(models: Mapping[str, pa.Table]) -> None:
    rows = models["shapes"]
    ids, counts = np.unique(rows["entity"].to_numpy(), return_counts=True)
    _check_numbers(
        "shapes", rows, "shape", dict(zip(ids.tolist(), counts.tolist(), strict=True)), 0
    )
    _check_links_of("shapes", rows, _link_counts(models["entities"]))
    known = models["geometries"]["id"].to_numpy()
    if not np.isin(rows["geometry"].to_numpy(), known).all():
        _fail("a shape has an unknown geometry")
    turns = np.column_stack([rows[name].to_numpy() for name in ("qw", "qx", "qy", "qz")])
    if len(turns) and not np.linalg.norm(turns, axis=1).min() > _SHORTEST:
        _fail("the orientation of a shape has the length 0")
    if len(rows) and min(rows["margin"].to_pylist()) < 0.0:
        _fail("the margin of a shape is negative")


def _link_counts(entities: pa.Table) -> dict[int, int]:
    """Returns the number of links of each body."""
    ids, kinds, links = (entities[name].to_pylist() for name in ("id", "kind", "links"))
    counts = {id: n for id, kind, n in zip(ids, kinds, links, strict=True) if kind != "sensor"}
    if any(count < 1 for count in counts.values()):
        _fail("a body has no links")
    return counts


def _joint_counts(entities: pa.Table) -> dict[int, int]:
    """Returns the number of joints of each body."""
    links = _link_counts(entities)
    counts = zip(entities["id"].to_pylist(), entities["joints"].to_pylist(), strict=True)
    return {id: count for id, count in counts if id in links}


def _check_links_of(what: str, rows: pa.Table, links: Mapping[int, int]) -> None:
    """Checks that the parts of bodies are on links that the bodies have."""
    for owner, link in zip(rows["entity"].to_pylist(), rows["link"].to_pylist(), strict=True):
        if not 0 <= link < links.get(owner, 0):
            _fail(f"a {what.removesuffix('s')} is on an unknown link of the entity {owner}")


def _check_numbers(
    what: str, rows: pa.Table, key: str, counts: Mapping[int, int], first: int
) -> None:
    """Checks that the parts of each body have the numbers from a first one on, each once."""
    owners, numbers = rows["entity"].to_numpy(), rows[key].to_numpy()
    order = np.lexsort((numbers, owners))
    expected = sorted(id for id in counts if counts[id] > 0)
    sizes = np.array([counts[id] for id in expected], dtype=np.int64)
    if len(rows) != sizes.sum() or (owners[order] != np.repeat(expected, sizes)).any():
        _fail(f"the {what} are not those of the bodies")
    starts = np.repeat(np.cumsum(sizes) - sizes, sizes)
    if (numbers[order] != np.arange(len(rows)) - starts + first).any():
        _fail(f"the numbers of a body's {what} have gaps")


def _check_unique(column: str, values: Array, least: int, end: int) -> None:
    if len(np.unique(values)) < len(values):
        _fail(f"its column {column!r} has a number twice")
    if len(values) and not least <= values.min() <= values.max() < end:
        _fail(f"its column {column!r} has a number out of bounds")


def _check_known(column: str, values: Iterable[str], known: tuple[str, ...]) -> None:
    for value in values:
        if value not in known:
            _fail(f"its column {column!r} has the value {short_repr(value)}")
