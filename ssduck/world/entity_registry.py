"""Registers the entities of a world: the bodies of its simulator and the sensors on them.

`no_entity_error` tells what else has a name that no entity has.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import count
from typing import Any

import numpy as np

from ssduck.errors import (
    ArgumentError,
    SceneError,
    UnknownNameError,
    UnsupportedError,
    nearest,
    printable,
)
from ssduck.formatting import joined_names, name_path, short_repr
from ssduck.schema import LINK_FACTOR
from ssduck.simulators.interface import Body, Simulator
from ssduck.simulators.naming import unique_name
from ssduck.simulators.scenes import SensorSpec, read_sensor
from ssduck.simulators.sensor_types import SENSOR_TYPES
from ssduck.world.layout import EntityInfo

# What to write for what is a table in SQL.
_SOURCES = {
    "entities": "its entities are FROM {0}",
    "links": "its links are FROM links({0})",
    "sites": "its sites are FROM sites({0})",
    "joints": "joint({0}.arm, 'name') is the position of a joint; the table is for ss.sql: "
    "SELECT * FROM {0}.joints",
    "time": "the simulated time is getTime()",
    "contacts": "inContact(a, b) asks for contacts; the table is for ss.sql: "
    "SELECT * FROM {0}.contacts",
}
# How MuJoCo gives the values of parts of a model that worlds do not read.
_VALUES = {
    "sensor": "data.sensor({}).data.tolist()",
    "actuator": "data.actuator({}).ctrl.tolist()",
    "camera": "data.camera({}).xpos.tolist()",
    "tendon": "data.tendon({}).length.tolist()",
    "keyframe": "model.key({}).qpos.tolist()",
}
# At most so many parts that have the name that no entity has are told of.
_MAX_OWNERS = 3
# Of a world in which no name is near, this number of names are told.
_MAX_NAMES = 5


class EntityRegistry:
    """The entities of a world, each with an id that is never used again.

    Attributes:
        entities: the current entities; a new list whenever entities were added or removed.
        removed: the simulated times, s, at which those of a name were found to be removed.
    """

    def __init__(self, entities: list[EntityInfo]) -> None:
        self.entities = entities
        self.removed: dict[str, float] = {}
        self._ids = count(1)

    def add_all(self, simulator: Simulator, sensors: Sequence[SensorSpec]) -> None:
        """Adds all bodies of a simulator, and the sensors on them."""
        # Ids follow the order of the entities: sensors first.
        sensor_ids = [self._new_id() for _ in sensors]
        self.update(simulator)
        self.entities = self._mounted(sensor_ids, sensors) + self.entities

    def update(self, simulator: Simulator) -> None:
        """Adds new bodies of the simulator, and removes entities whose bodies were removed."""
        changes = simulator.describe()
        if changes is None:
            return
        added, removed = changes
        removed_bodies = set(removed)
        removed_ids = {info.id for info in self.entities if info.body in removed_bodies}
        self._remove(
            lambda info: info.id in removed_ids or info.mount[0] in removed_ids, simulator.time
        )
        used_names = {info.name for info in self.entities}
        for body in added:
            name = unique_name(body.name, used_names)
            used_names.add(name)
            self.entities.append(EntityInfo(self._new_id(), name, body.kind, body=body))

    def _new_id(self) -> int:
        """Returns an id that no entity had."""
        id = next(self._ids)
        if id >= LINK_FACTOR:
            raise UnsupportedError(
                f"a world has at most {LINK_FACTOR - 1:,} entities in its time; begin a new one"
            )
        return id

    def get(self, id: int) -> EntityInfo | None:
        """Returns the entity of an id; None if it was removed."""
        return next((info for info in self.entities if info.id == id), None)

    def add_sensor(
        self, type: str, host: EntityInfo, name: str | None, settings: Mapping[str, Any]
    ) -> EntityInfo:
        """Adds a sensor on a body, with settings as in a scene file, by default with a new name."""
        if host.body is None:
            raise ArgumentError(f"add_sensor: on: {host.name!r} is a sensor, not a body")
        used_names = {info.name for info in self.entities}
        if name in used_names:
            raise ArgumentError(f"add_sensor: name: {name!r} is there already")
        values = {
            "type": type,
            "on": host.name,
            "name": name if name is not None else unique_name(f"{host.name}_{type}", used_names),
            **_plain(settings),
        }
        try:
            spec = read_sensor(values, [host.name])
            (info,) = self._mounted([self._new_id()], [spec])
        except SceneError as error:
            message = f"add_sensor: {error.message.removeprefix('sensor[0].')}"
            raise ArgumentError(message, suggestions=error.suggestions) from error
        self.entities = [*self.entities, info]
        return info

    def remove(self, id: int, time: float) -> None:
        """Removes a sensor, at a simulated time, s."""
        self._remove(lambda info: info.id == id, time)

    def _remove(self, is_gone: Callable[[EntityInfo], bool], time: float) -> None:
        self.removed |= {info.name: time for info in self.entities if is_gone(info)}
        self.entities = [info for info in self.entities if not is_gone(info)]

    def has_body(self, body: Body) -> bool:
        """Checks whether a body is that of an entity, and was not removed."""
        return any(info.body is body for info in self.entities)

    def host(self, on: str, world: str) -> EntityInfo:
        """Returns the body of a new sensor, given by its name."""
        for info in self.entities:
            if info.name == on:
                return info
        error = no_entity_error(world, on, self.entities)
        error.message = f"add_sensor: on: {error.message}"
        if on in SENSOR_TYPES:
            error.message += "; the type comes first: add_sensor(type, on)"
        raise error

    def _mounted(self, ids: Iterable[int], specs: Sequence[SensorSpec]) -> list[EntityInfo]:
        """Returns sensors of specifications, with their bodies and links."""
        by_name = {info.name: info for info in self.entities}
        sensors = []
        for index, (id, spec) in enumerate(zip(ids, specs, strict=True)):
            host = by_name.get(spec.on)
            if host is None:
                raise SceneError(
                    f"sensor[{index}].on: there is no body {spec.on!r} for the sensor "
                    f"{spec.name!r}",
                    suggestions=nearest(spec.on, by_name),
                )
            mount = (host.id, _link_number(host, spec, index))
            sensors.append(
                EntityInfo(id, spec.name, "sensor", parent=spec.on, sensor=spec, mount=mount)
            )
        return sensors


def _plain(value: Any) -> Any:
    """Converts numpy values to Python's and sequences to lists; returns other values unchanged."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    is_list = isinstance(value, Sequence) and not isinstance(value, str)
    return [_plain(part) for part in value] if is_list else value


def _link_number(host: EntityInfo, spec: SensorSpec, index: int) -> int:
    assert host.body is not None
    if spec.link is None:
        return 0
    names = [link.name for link in host.body.links]
    if spec.link not in names:
        raise SceneError(
            f"sensor[{index}].link: {host.name!r} has no link {spec.link!r}",
            suggestions=nearest(spec.link, names),
        )
    return names.index(spec.link)


def no_entity_error(
    world: str, name: str, infos: Sequence[EntityInfo], removal: str = ""
) -> UnknownNameError:
    """Returns the error for a name that no entity has, with what is told of one that had it."""
    message = f"world {world!r} has no entity {short_repr(name)}"
    told = removal or told_of_part(world, name, infos)
    if not told:
        told = _SOURCES[name].format(world) if name in _SOURCES else ""
    if told:
        return UnknownNameError(f"{message}; {told}")
    near = nearest(name, [info.name for info in infos])
    if not near:
        paths_of = {link: f"{owner}.{link}" for owner, link in _links(infos)}
        near = tuple(paths_of[link] for link in nearest(name, paths_of))
    if near and not near[0].isidentifier():
        message += f"; names with other signs are written {name_path(world, near[0])}"
    elif not near and infos:
        message += f", only {joined_names([printable(i.name) for i in infos], _MAX_NAMES)}"
    return UnknownNameError(message, suggestions=near)


def _links(infos: Sequence[EntityInfo]) -> list[tuple[str, str]]:
    """Returns the entities' names with those of their links."""
    return [(i.name, link.name) for i in infos if i.body is not None for link in i.body.links]


def told_of_part(world: str, name: str, infos: Sequence[EntityInfo]) -> str:
    """Returns what to write for the name of a part of a world's model; "" if none has it."""
    bodies = [(info.name, info.body) for info in infos if info.body is not None]
    if any(info.name == name for info in infos):
        return f"for the entity, write {name_path(world, name)}"
    for owner, part in _links(infos):
        if f"{owner}.{part}" == name:
            path = name_path(world, owner, part)
            return f"it is a link: write {path}; all links are FROM links({world})"
    owners = [owner for owner, link in _links(infos) if link == name]
    if owners:
        choices = " or ".join(name_path(world, owner, name) for owner in owners[:_MAX_OWNERS])
        return f"a part of another one has that name: write {choices}"
    for owner, body in bodies:
        if any(joint.name == name for joint in body.joints):
            return f"it is a joint: write joint({name_path(world, owner)}, {name!r})"
        for number, link in enumerate(body.links):
            if name in link.geoms:
                part = (
                    name_path(world, owner) if number == 0 else name_path(world, owner, link.name)
                )
                told = f"it is a geom, a shape of the body {link.name}: write {part}"
                return told + (", which has all of its shapes" if len(link.geoms) > 1 else "")
    kind = next((body.unread[name] for _, body in bodies if name in body.unread), "")
    return _told_of_unread(kind, name) if kind else ""


def _told_of_unread(kind: str, name: str) -> str:
    """Returns what to write for a part of a model that worlds do not read."""
    if kind not in _VALUES:
        return f"it is a {kind} of the model; entities are bodies, their parts links and sites"
    value = _VALUES[kind].format(repr(name))
    article = "an" if kind.startswith("a") else "a"
    return (
        f"it is {article} {kind} of the model, which a world does not read: give its value as a "
        f"variable after each tick, ss.add_variable({name!r}, {value})"
    )
