"""What can be done to the bodies of a world: `ManipulableSimulation`."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ssduck import validation
from ssduck.errors import ArgumentError, StateError
from ssduck.geometry.narrow_phase import TOUCHING_DISTANCE
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
    """A simulator with its last tick, whose bodies can be moved, driven, held and hidden."""

    def place(self, entity: Entity, pose: Pose | None, joints: JointValues | None) -> None:
        """Put a body's link frame and its joints there and take a tick; see `Entity.move`."""

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
        """Set motors of its joints, for the steps to come; see `Entity.drive`."""
        with self.lock:
            self._check_not_pinned()
            body = self._present(entity, "drive")
            motors = motor_targets(positions, velocities, efforts, body, entity.name)
            self._simulator.drive(body, motors)

    def hold(self, entity: Entity, other: Entity, link: str | None, touching: int) -> None:
        """Tie a body to a link that touches it, and take a tick; see `Entity.hold`."""
        with self.lock:
            self._check_not_pinned()
            touching = validation.integer(touching, "hold: touching", minimum=1)
            body, held = (self._present(one, "hold") for one in self._two(entity, other, "hold"))
            number = 0 if link is None else link_index(body, link, entity.name)
            if self._simulator.has_constraint(body, held):
                raise StateError(f"{entity.name} holds {other.name} already")
            self._take_tick()
            with self.pinned(("shapes", MARGINS)):
                shapes = self.snapshot.shapes().shapes_touching(
                    entity.id, other.id, TOUCHING_DISTANCE
                )
            touch = {body.shapes[shape].frame for shape in shapes}
            count = len(touch & descendant_links(body, number))
            if count < touching:
                raise StateError(
                    f"{entity.name} cannot hold {other.name}: {count} links of "
                    f"{body.links[number].name!r} and beyond are within {TOUCHING_DISTANCE:g} m of "
                    f"it, not {touching}; move them there first"
                )
            self._simulator.add_constraint(body, number, held)

    def release(self, entity: Entity, other: Entity) -> None:
        """Untie what `hold` tied; see `Entity.release`."""
        with self.lock:
            self._check_not_pinned()
            body, held = (
                self._present(one, "release") for one in self._two(entity, other, "release")
            )
            if not self._simulator.has_constraint(body, held):
                raise StateError(f"{entity.name} does not hold {other.name}")
            self._simulator.remove_constraint(body, held)

    def _two(self, entity: Entity, other: Entity, verb: str) -> tuple[Entity, Entity]:
        """Two entities of this world that are not the same."""
        if not isinstance(other, Entity) or other.world is not self:
            raise ArgumentError(f"{verb}: {other!r} is no entity of the world {self.name!r}")
        if other == entity:
            raise ArgumentError(f"{verb}: {entity.name} itself")
        return entity, other

    def enable(self, entity: Entity, on: bool) -> None:
        """Let a body take part in collisions, or not, and take a tick."""
        on = validation.boolean(on, "enabled")
        self._change(entity, "enable", lambda body: self._simulator.enable(body, on))

    def show(self, entity: Entity, on: bool) -> None:
        """Let a body be drawn, or not, and take a tick."""
        on = validation.boolean(on, "visible")
        self._change(entity, "show", lambda body: self._simulator.show(body, on))

    def _change(self, entity: Entity, verb: str, change: Callable[[Body], None]) -> None:
        """Change a body in the simulator, and take a tick."""
        with self.lock:
            self._check_not_pinned()
            change(self._present(entity, verb))
            self.snapshot.invalidate_static_poses()
            self._take_tick()

    def _present(self, entity: Entity, verb: str) -> Body:
        """What an entity is made of, if the simulation still has it."""
        self._registry.update(self._simulator)  # its number may be another body's by now
        info = self._registry.of(entity.id)
        if info is None:
            raise entity.removed()
        return entity.body_of(info, verb)
