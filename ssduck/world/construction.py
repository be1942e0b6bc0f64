"""Makes worlds: `ConstructibleWorld.load` of scenes, `attach` of simulations of the user's."""

from __future__ import annotations

import weakref
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Self

from ssduck import validation
from ssduck.errors import ArgumentError, SceneError
from ssduck.formatting import short_repr
from ssduck.lazy import service
from ssduck.simulators.backends import ShapesByBody, backend
from ssduck.simulators.interface import Kind, Simulator
from ssduck.simulators.recognition import simulator_of, simulator_of_scene
from ssduck.simulators.scenes import Camera, Scene, SensorSpec

# The name of a world that is not bound to a variable yet.
UNNAMED = "world"


class ConstructibleWorld:
    """The constructors of worlds."""

    # Closes the simulator of a world that owns it.
    _finalizer: weakref.finalize[..., Self] | None = None

    if TYPE_CHECKING:

        def __init__(
            self,
            simulator: Simulator,
            *,
            name: str = UNNAMED,
            sensors: Sequence[SensorSpec] = (),
            camera: Camera | None = None,
        ) -> None: ...

    @classmethod
    def load(cls, scene: Scene, *, simulator: str | None = None) -> Self:
        """Loads a scene into a new simulation, and returns its world.

        Args:
            scene: the scene.
            simulator: the name of the simulator, see `BACKENDS`; by default MuJoCo, if it is
                installed, for an MJCF file by itself, and PyBullet for everything else; the one
                that is installed, if the other is not.

        Raises:
            SceneError: the scene cannot be loaded; the message has file, key and reason.
            ArgumentError: `scene` is no `Scene`.
            UnsupportedError: the simulator is not installed, or does not load such scenes.
        """
        if not isinstance(scene, Scene):
            raise ArgumentError(
                f"load: {short_repr(scene)} is no Scene; find_scene of ssduck.simulators reads one"
            )
        loaded = backend(simulator or simulator_of_scene(scene)).load(scene)
        try:
            return cls.owning(loaded, scene.name, scene.sensors, scene.camera)
        except SceneError as error:
            message = f"{scene.path}: {error.message}"
            raise SceneError(message, suggestions=error.suggestions) from error

    @classmethod
    def owning(
        cls, simulator: Simulator, name: str, sensors: Sequence[SensorSpec], camera: Camera
    ) -> Self:
        """Returns a world that owns its simulator, and closes it when the world is collected."""
        try:
            world = cls(simulator, name=name, sensors=sensors, camera=camera)
        except BaseException:
            simulator.close()
            raise
        # A simulation takes tens of megabytes.
        world._finalizer = weakref.finalize(world, simulator.close)
        return world

    @classmethod
    def attach(
        cls,
        client: Any,
        *data_names_kinds: Any,
        names: Mapping[Any, str] | None = None,
        kinds: Mapping[Any, Kind] | None = None,
        name: str = UNNAMED,
        shapes: ShapesByBody | None = None,
        simulator: str | None = None,
        forward: bool = False,
        camera: Camera | None = None,
    ) -> Self:
        """Returns a world around a simulation that you created and continue to use.

        `World.attach(client)` takes a PyBullet client, `World.attach(model, data)` a MuJoCo model
        with its data. The next `tick()` sees what you changed: bodies that you added, removed or
        moved, or a model that you made anew.

        A PyBullet client has no time: it begins at 0, and each `tick()`, which stands for one step
        of yours, advances it by the client's time step, as does each step of `step` and `run`.
        ssduck attaches user data to each body, to distinguish a removed body from a later one with
        the same number. In MuJoCo the time is that of the data. A new episode begins when the time
        has fallen, or the model is another one.

        Args:
            client: of PyBullet, the number of the client, or an object with this number as
                `_client`. Of MuJoCo, the model, an environment that has model and data, or a
                function that returns (model, data), which is called at each tick.
            *data_names_kinds: MuJoCo's data, if `client` is a model; then `names` and `kinds`.
            names: the names of present bodies. Of PyBullet by body number; other bodies are named
                as in their models, as identifiers, made unique. Of MuJoCo by the number or the name
                of the root body of an entity; others have MuJoCo's name of that.
            kinds: `"robot"` or `"kinbody"`, likewise; by default a body with movable joints is a
                robot.
            name: the name until the world is bound to a variable.
            shapes: for PyBullet, collision shapes of present bodies, which replace those that it
                reports: of a body's base by its number, of a link by (body, link), of one of its
                shapes by (body, link, number), with PyBullet's link numbers (the base is -1).
                Each is a mesh in the frame of the link, m, or a list of meshes: a
                `trimesh.Trimesh`, (vertices (n, 3), faces (m, 3)), or the path of a mesh file;
                faces of None make the convex hull. See `ssduck.height_field`.
            simulator: the name of the simulator, see `BACKENDS`; None to recognise it.
            forward: for MuJoCo, whether a tick has the poses and contacts at its time, which
                `qpos` tells, also of free joints. Those of the data, as code that reads `xpos`
                sees them, are of the beginning of the last step.
            camera: the camera of pictures, of films and of the page, a `Camera` of
                `ssduck.simulators.scenes`; by default one that frames what is small and moves.
                `world.camera = …` sets another one.

        Raises:
            SimulatorError: the client is not connected, or the object has no simulation that is
                known.
            SelectScriptError: no body has a number, or a kind is invalid.
            UnknownNameError: no body has a name; with the nearest names.
            ArgumentError: no shape has a key of `shapes`, or a value is no mesh; or two bodies have
                one name.
            UnsupportedError: MuJoCo is not installed.
        """
        forward = validation.boolean(forward, "attach: forward")
        client, (names, kinds) = _simulation(client, data_names_kinds, names, kinds)
        _check_distinct(names)
        name_of_simulator = simulator_of(client) if simulator is None else simulator
        options: dict[str, bool] = {"forward": forward} if forward else {}
        attached = backend(name_of_simulator).attach(client, names, kinds, shapes, **options)
        return cls(attached, name=name, camera=camera)

    @staticmethod
    def batch(model: Any, count: int, *, name: str = UNNAMED, history: int = 0) -> Any:
        """Returns many simulations of one model as one world, a `BatchWorld`, in its initial state.

        Programs are evaluated over all of them, the *environments*, at once: `ss.eval` returns an
        array with a value for each. `tick` takes their states, as arrays of any library.

        Args:
            model: a `mujoco.MjModel`; or a world whose bodies each environment has, for states
                from any other simulator.
            count: the number of environments, from 1 up.
            name: the name until the world is bound to a variable.
            history: the largest number of ticks whose states are kept in memory, for
                `Interpreter.export_batch`; older ones are dropped.

        Raises:
            SimulatorError: the object is no model that is known.
            UnsupportedError: MuJoCo is not installed.

        >>> import mujoco
        >>> import ssduck
        >>> ball = "<body name='ball'><freejoint/><geom size='0.1'/></body>"
        >>> text = f"<mujoco><worldbody>{ball}</worldbody></mujoco>"
        >>> with ssduck.Interpreter() as ss:
        ...     sim = ss["sim"] = ssduck.World.batch(mujoco.MjModel.from_xml_string(text), count=2)
        ...     _ = sim.tick(qpos=[[0, 0, 0.5, 1, 0, 0, 0], [0, 0, 1.5, 1, 0, 0, 0]], time=0.0)
        ...     ss.eval("z(sim.ball) > 1;").tolist()
        [False, True]
        """
        return service("batch")(model, count, name, history)


def _check_distinct(names: Any) -> None:
    """Checks that no two bodies have one name."""
    bodies: dict[str, Any] = {}
    for body, name in names.items() if isinstance(names, Mapping) else ():
        if isinstance(name, str) and bodies.setdefault(name, body) is not body:
            raise ArgumentError(
                f"attach: names: the bodies {short_repr(bodies[name])} and {short_repr(body)} "
                f"both have the name {short_repr(name)}: a name is that of one entity"
            )


def _simulation(
    client: Any, more: Sequence[Any], names: Any, kinds: Any
) -> tuple[Any, tuple[Any, Any]]:
    """Returns the simulation, names and kinds, of which some have no name in a call."""
    values = list(more)
    if values and not (values[0] is None or isinstance(values[0], Mapping)):
        client = client, values.pop(0)
    named = {"names": names, "kinds": kinds}
    if len(values) > len(named):
        raise ArgumentError(f"attach: too many values: {', '.join(map(short_repr, values))}")
    for (argument, known), value in zip(named.items(), values, strict=False):
        if known is not None:
            raise ArgumentError(f"attach: {argument} are given twice")
        validation.mapping(value, f"attach: {argument} are given in a dict")
        named[argument] = value
    return client, (named["names"], named["kinds"])
