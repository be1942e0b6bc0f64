"""Who is in a world: the bodies that its simulator tells of, and the sensors on them."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from itertools import count
from typing import Any

from ssduck.errors import ArgumentError, SceneError, UnknownNameError, nearest
from ssduck.simulators.interface import Simulator
from ssduck.simulators.scenes import SensorSpec, read_sensor
from ssduck.world.entities import Entity
from ssduck.world.layout import EntityInfo


class EntityRegistry:
    """The members of a world, each under an id that is never used again.

    Args:
        listed: those that are there, sensors first, each in load order.

    Attributes:
        listed: the same as they are now; another list whenever some came or went.
    """

    def __init__(self, listed: list[EntityInfo]) -> None:
        self.entities = listed
        self._ids = count(1)

    def begin(self, simulator: Simulator, sensors: Sequence[SensorSpec]) -> None:
        """Take note of all bodies of a simulator, and of the sensors on them.

        Raises:
            SceneError: a sensor is to be on a link that its body has not.
        """
        # Ids count as worlds list: sensors first.
        sensor_ids = [next(self._ids) for _ in sensors]
        self.update(simulator)
        self.entities = self._mounted(sensor_ids, sensors) + self.entities

    def update(self, simulator: Simulator) -> None:
        """Take note of bodies that came and went."""
        changes = simulator.describe()
        if changes is None:
            return
        came, gone = changes
        gone_bodies = set(gone)
        gone_ids = {info.id for info in self.entities if info.body in gone_bodies}
        self.entities = [
            info
            for info in self.entities
            if info.id not in gone_ids and info.mount[0] not in gone_ids
        ]
        taken = {info.name for info in self.entities}
        for body in came:
            name = _unique(body.name, taken)
            taken.add(name)
            self.entities.append(EntityInfo(next(self._ids), name, body.kind, body=body))

    def of(self, id: int) -> EntityInfo | None:
        """The member of that id; None if it is there no longer."""
        return next((info for info in self.entities if info.id == id), None)

    def add_sensor(
        self, type: str, host: EntityInfo, name: str | None, settings: Mapping[str, Any]
    ) -> EntityInfo:
        """Put a sensor on a body.

        Args:
            type: of the sensor.
            host: the body.
            name: unique in the world; None for one that is made of the two above.
            settings: as a scene file has them.

        Raises:
            ArgumentError: the name is taken, or a setting is wrong.
        """
        taken = {info.name for info in self.entities}
        if name in taken:
            raise ArgumentError(f"add_sensor: name: {name!r} is there already")
        values = {
            "type": type,
            "on": host.name,
            "name": name if name is not None else _unique(f"{host.name}_{type}", taken),
            **settings,
        }
        try:
            spec = read_sensor(values, [host.name])
            (info,) = self._mounted([next(self._ids)], [spec])
        except SceneError as error:
            message = f"add_sensor: {error.message.removeprefix('sensor[0].')}"
            raise ArgumentError(message, suggestions=error.suggestions) from error
        self.entities = [*self.entities, info]
        return info

    def remove(self, id: int) -> None:
        """Take a sensor away."""
        self.entities = [info for info in self.entities if info.id != id]

    def host(self, on: str | Entity, world: str) -> EntityInfo:
        """The body that a sensor is to sit on.

        Args:
            on: its name, or its handle.
            world: what the world is called.

        Raises:
            UnknownNameError: there is no body of that name, with the nearest names.
            RemovedEntityError: the entity is there no longer.
            ArgumentError: it is a sensor.
        """
        if isinstance(on, Entity):
            found = [info for info in self.entities if info.id == on.id]
            if not found:
                raise on.removed()
        else:
            found = [info for info in self.entities if info.name == on]
        if not found:
            known = [info.name for info in self.entities if info.body is not None]
            raise UnknownNameError(
                f"world {world!r} has no body {on!r}", suggestions=nearest(on, known)
            )
        if found[0].body is None:
            raise ArgumentError(f"add_sensor: on: {found[0].name!r} is a sensor, not a body")
        return found[0]

    def _mounted(self, ids: Iterable[int], specs: Sequence[SensorSpec]) -> list[EntityInfo]:
        """The sensors on the bodies that carry them."""
        by_name = {info.name: info for info in self.entities}
        sensors = []
        for index, (id, spec) in enumerate(zip(ids, specs, strict=True)):
            host = by_name.get(spec.on)
            if host is None:
                raise SceneError(
                    f"there is no body {spec.on!r} for the sensor {spec.name!r}",
                    suggestions=nearest(spec.on, by_name),
                )
            mount = (host.id, _link_number(host, spec, index))
            sensors.append(
                EntityInfo(id, spec.name, "sensor", parent=spec.on, sensor=spec, mount=mount)
            )
        return sensors


def _unique(name: str, taken: Container[str]) -> str:
    """The name, or the name and a number if it is taken already."""
    if name not in taken:
        return name
    return next(n for n in (f"{name}_{i}" for i in count(2)) if n not in taken)


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
