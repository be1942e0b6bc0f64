"""Lists only public names in `dir`, and so in completions; explains unknown ones."""

from __future__ import annotations

from abc import ABCMeta
from collections.abc import Iterable, Mapping
from inspect import isfunction
from types import MethodType
from typing import TYPE_CHECKING, Any, ClassVar

from ssduck.lazy import service


class _PublicNamesType(ABCMeta):
    """The type of these classes: their own `dir` is that of their objects."""

    INTERNAL_NAMES: frozenset[str]
    INSTEAD_OF: Mapping[str, str]

    def __dir__(cls) -> Iterable[str]:
        names = (name for name in super().__dir__() if name not in cls.INTERNAL_NAMES)
        return [*names, *service("spellings")(cls)]

    if not TYPE_CHECKING:  # type checkers would allow any attribute

        def __getattr__(cls, name: str) -> Any:
            spellings = service("spellings")(cls) if name[:1].isupper() else {}
            if name not in spellings:
                told = f"; {cls.INSTEAD_OF[name]}" if name in cls.INSTEAD_OF else ""
                message = f"type object {cls.__name__!r} has no attribute {name!r}{told}"
                raise AttributeError(message, name=name, obj=cls)
            return spellings[name]


class PublicNames(metaclass=_PublicNamesType):
    """A base class whose `dir` leaves out the names that only other packages of ssduck use.

    If the object contains an item of the name of an unknown attribute, the error shows how to
    get it.
    """

    __slots__ = ()

    INTERNAL_NAMES: ClassVar[frozenset[str]] = frozenset(("INTERNAL_NAMES", "INSTEAD_OF"))
    # What there is in place of a name that users of other libraries look for.
    INSTEAD_OF: ClassVar[Mapping[str, str]] = {}

    def __dir__(self) -> Iterable[str]:
        names = (name for name in super().__dir__() if name not in self.INTERNAL_NAMES)
        return [*names, *service("spellings")(type(self))]

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            kind: Any = type(self)
            if name[:1].isupper() and hasattr(kind, name):
                found = getattr(kind, name)
                return MethodType(found, self) if isfunction(found) else found
            message = f"{kind.__name__!r} object has no attribute {name!r}"
            # An attribute of the class is here if its property raised an AttributeError.
            is_unknown = not name.startswith("_") and not hasattr(kind, name)
            if is_unknown and hasattr(kind, "__contains__") and name in self:
                message += f"; write [{name!r}] instead of .{name}"
            elif is_unknown and name in self.INSTEAD_OF:
                message += f"; {self.INSTEAD_OF[name]}"
            raise AttributeError(message, name=name, obj=self)


def _names(text: str) -> frozenset[str]:
    return frozenset(text.split())


WORLD_INTERNALS = _names(
    "INSTEAD_OF INTERNAL_NAMES handle is_final lock notify_observers observers origin owning "
    "part_hint pinned posed reading request_tables serial steps_to_tick ticker"
)
HANDLE_INTERNALS = _names(
    "INSTEAD_OF INTERNAL_NAMES TABLE body_of changed column info key_hint moment part_hint pinned "
    "removed state"
)


def _told(*entries: tuple[str, str]) -> dict[str, str]:
    """Returns what to write, by each of the names that stand before it."""
    return {name: told for names, told in entries for name in names.split()}


# What there is in place of names that users of other libraries look for.
INSTEAD_IN_INTERPRETERS = _told(
    ("save export_record write", "export(folder) writes a world's ticks"),
    ("load open", "ssduck.load(scene) and ssduck.open(record) return interpreters"),
    ("query execute run_query", "eval(program) runs SelectScript, and sql(text) SQL"),
    ("run_sql eval_sql execute_sql", "sql(text) runs SQL"),
    ("remove_trigger delete_trigger", "del_trigger(name) removes a trigger"),
    ("step tick", "a world does that: ss['room'].step(); run(seconds) runs all worlds"),
    ("set_variable add_world attach", "add_variable('room', ssduck.World.attach(client))"),
    ("get_variable world variable", "a variable is ss['room']; the worlds are ss.worlds"),
    ("variables", "list(ss) has the names of the variables, and ss['room'] their values"),
    ("add_udf register_function define", "add_function(name, function, help) adds a function"),
)
_OF_THE_INTERPRETER = _names("eval sql export record record_to add_trigger add_function past")
_OF_INTERPRETERS = "that is for the interpreter that has the world: ss."
INSTEAD_IN_WORLDS = _told(
    *((name, f"{_OF_INTERPRETERS}{name}(…)") for name in sorted(_OF_THE_INTERPRETER)),
    ("query", f"{_OF_INTERPRETERS}eval(…)"),
    ("history", f"{_OF_INTERPRETERS}past(…), or queries of room{{0.5}}"),
    ("entities bodies objects", "a world is iterated: for entity in world; one is world['cup']"),
    ("names ids", "[entity.name for entity in world]"),
    ("robots", "[entity for entity in world if entity.kind == 'robot']"),
    ("get body entity_by_name", "an entity is world['cup']"),
    ("joints", "those of an entity are world['arm'].joints"),
    ("contacts", "inContact(a, b) asks for them, and ss.sql('FROM room.contacts')"),
    ("from_mujoco from_mjcf from_model", "ssduck.World.attach(model, data) makes a world"),
    ("from_pybullet from_client connect", "ssduck.World.attach(client) makes a world"),
    ("load open from_file from_scene", "ssduck.load(scene) returns an interpreter of its world"),
    ("reset", "reset the simulator, and call begin_episode(); or load the scene again"),
    ("dt time_step", "the time step is .timestep, s"),
    ("simulate", "run(seconds) runs the simulation, and step(n) n steps of it"),
    ("state snapshot_state", "ss.sql('FROM room.entities') has the state as rows"),
    ("ticks", "those that are recorded are ss.past('room').times"),
)
INSTEAD_IN_HANDLES = _told(
    ("pos xyz translation", "write .position, [x, y, z] in m"),
    *((axis, f"write .position[{place}]") for place, axis in enumerate("xyz")),
    ("orn quat quaternion rotation", "write .orientation, [w, x, y, z]"),
    ("rpy euler", "write .orientation, [w, x, y, z], of which SciPy's Rotation makes angles"),
    ("vel linear_velocity", "write .velocity[:3], m/s"),
    ("angular_velocity", "write .velocity[3:], rad/s"),
    ("bbox bounds bounding_box extents size", "write .aabb, the lower and the upper corner"),
)
INSTEAD_IN_ENTITIES = INSTEAD_IN_HANDLES | _told(
    ("set_position set_pose move_to teleport", "write .move(position, orientation)"),
    ("set_orientation", "write .move(orientation=…)"),
    ("set_joints set_joint_positions", "write .move(joints={'name': 0.5})"),
    ("joint", "a joint is .joints['name']"),
    ("q qpos joint_positions", "write [joint.position for joint in arm.joints]"),
    ("qvel joint_velocities", "write [joint.velocity for joint in arm.joints]"),
    ("dof num_joints", "write len(arm.joints)"),
    ("remove delete", "write world.remove(entity)"),
    ("apply_force apply_torque", "forces are applied by the simulator's own functions"),
)
