"""Moves, drives, holds, enables and shows the bodies of a world: `ManipulableSimulation`."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ssduck import validation
from ssduck.errors import ArgumentError, StateError
from ssduck.geometry.shape_comparisons import TOUCHING_DISTANCE
from ssduck.schema import MARGINS
from ssduck.simulators.interface import Body
from ssduck.simulators.kinematics import (
    JointValues,
    Pose,
    descendant_links,
    joint_positions,
    link_index,
    motor_targets,
)
from ssduck.world.entities import Entity
from ssduck.world.ticking import SteppedSimulation


class ManipulableSimulation(SteppedSimulation):
    """A stepped simulation whose bodies can be moved, driven, held and hidden."""

    def place(self, entity: Entity, pose: Pose | None, joints: JointValues | None) -> None:
        """Sets the pose and the joints of a body, and takes a tick; see `Entity.move`."""

        def put(body: Body) -> None:
            values = {} if joints is None else joint_positions(joints, body, entity.name)
            if pose is not None:
                self._simulator.place(body, *pose)
            if values:
                self._simulator.set_joints(body, values)

        self._change(entity, "move", put)

    def drive(
        self,
        entity: Entity,
        positions: JointValues | None,
        velocities: Mapping[str, float] | None,
        efforts: Mapping[str, float] | None,
    ) -> None:
        """Sets the motors of a body's joints for the following steps; see `Entity.drive`."""
        with self.lock:
            self._check_not_pinned()
            body = self._body_of(entity, "drive")
            motors = motor_targets(positions, velocities, efforts, body, entity.name)
            self._simulator.drive(body, motors)

    def hold(self, entity: Entity, other: Entity, link: str | None, touching: int) -> None:
        """Attaches a body to a link that touches it, and takes a tick; see `Entity.hold`."""
        with self.lock:
            self._check_not_pinned()
            touching = validation.integer(touching, "hold: touching", minimum=1)
            body, held_body = self._two_bodies(entity, other, "hold")
            number = 0 if link is None else link_index(body, link, entity.name)
            if self._simulator.has_constraint(body, held_body):
                raise StateError(f"{entity.name} holds {other.name} already")
            self._take_tick()
            with self.pinned(("shapes", MARGINS)):
                shapes = self.snapshot.shapes().shapes_touching(
                    entity.id, other.id, TOUCHING_DISTANCE
                )
            links = {body.shapes[shape].frame for shape in shapes}
            count = len(links & descendant_links(body, number))
            if count < touching:
                raise StateError(
                    f"{entity.name} cannot hold {other.name}: {count} links of "
                    f"{body.links[number].name!r} and beyond are within {TOUCHING_DISTANCE:g} m of "
                    f"it, not {touching}; move them there first"
                )
            self._simulator.add_constraint(body, number, held_body)

    def release(self, entity: Entity, other: Entity) -> None:
        """Detaches a body that `hold` attached; see `Entity.release`."""
        with self.lock:
            self._check_not_pinned()
            body, held_body = self._two_bodies(entity, other, "release")
            if not self._simulator.has_constraint(body, held_body):
                raise StateError(f"{entity.name} does not hold {other.name}")
            self._simulator.remove_constraint(body, held_body)

    def _two_bodies(self, entity: Entity, other: Entity, verb: str) -> tuple[Body, Body]:
        """Returns the bodies of two different entities of this world."""
        if not isinstance(other, Entity) or other.world is not self:
            raise ArgumentError(f"{verb}: {other!r} is no entity of the world {self.name!r}")
        if other == entity:
            raise ArgumentError(f"{verb}: {entity.name} cannot {verb} itself")
        return self._body_of(entity, verb), self._body_of(other, verb)

    def enable(self, entity: Entity, on: bool) -> None:
        """Enables or disables the collisions of a body, and takes a tick."""
        on = validation.boolean(on, "enabled")
        self._change(entity, "enable", lambda body: self._simulator.enable(body, on))

    def show(self, entity: Entity, on: bool) -> None:
        """Shows or hides a body, and takes a tick."""
        on = validation.boolean(on, "visible")
        self._change(entity, "show", lambda body: self._simulator.show(body, on))

    def _change(self, entity: Entity, verb: str, change: Callable[[Body], None]) -> None:
        """Changes a body in the simulator, and takes a tick."""
        with self.lock:
            self._check_not_pinned()
            change(self._body_of(entity, verb))
            self.snapshot.invalidate_static_poses()
            self._take_tick()

    def _body_of(self, entity: Entity, verb: str) -> Body:
        """Returns the body of an entity after checking that the simulation still has it."""
        self._registry.update(self._simulator)  # another body may have its number by now
        info = self._registry.get(entity.id)
        if info is None:
            raise entity.removed()
        return entity.body_of(info, verb)
