"""Numbers of the wrong kind: an error of ssduck's at once from every public function, no change.

`CALLS` has an entry for each number or flag that a public function of Python takes; a function
that comes without one fails a test here.
"""

import inspect
import math
import re
from fractions import Fraction

import numpy as np
import pybullet
import pytest
from typer.testing import CliRunner

import ssduck
from ssduck.adapters import grid_values as grids
from ssduck.adapters.result import Result, TableView
from ssduck.cli.app import app
from ssduck.errors import SelectScriptError
from ssduck.openrave import OccupancyGridMap
from ssduck.recording.replay.replayed_world import ReplayedWorld
from tests.support.bodies import solid
from tests.support.cases import sampled

HUGE = 10**400
NO_NUMBERS = ["1", "", None, [1], {}, 1j, math.nan, True, False]
# What is none, by what is expected.
BAD = {
    "steps": [*NO_NUMBERS, 0.5, 1.0, -1, -HUGE, HUGE, math.inf, np.float64(2), np.bool_(1)],
    "count": [*NO_NUMBERS, 0.5, 1.0, -1, -HUGE, math.inf, np.float64(2), np.bool_(1)],
    "above 0": [*NO_NUMBERS, 0.5, 1.0, 0, -1, -HUGE, math.inf, np.float64(2), np.bool_(1)],
    "pixels": [*NO_NUMBERS, 0.5, 0, -1, 8193, HUGE, math.inf],
    "seconds": [*NO_NUMBERS, -1, -0.1, math.inf, -math.inf, HUGE, -HUGE, np.nan, np.bool_(1)],
    "seconds above 0": [*NO_NUMBERS, 0, 0.0, -1, math.inf, -math.inf, HUGE, np.nan],
    "time": [*NO_NUMBERS, math.inf, -math.inf, HUGE, -HUGE, np.nan],
    "flag": ["yes", "", None, [], {}, 2, -1, 1.0, 0.5, math.nan, HUGE],
    "place": [5, "abc", "123", {}, [1, 2], [1, 2, 3, 4], [math.nan, 0, 0], [math.inf, 0, 0],
              [HUGE, 0, 0], ["1", "2", "3"], [True, 0, 0], [None] * 3, [[1, 2, 3]], [1j, 0, 0],
              np.array(["1", "2", "3"]), np.zeros((1, 3)), np.array([True] * 3)],
    "joints": [5, "ab", [], [1, 2, 3], {"slide": "1"}, {"slide": None}, {"slide": [1]}, [math.nan],
               {"slide": True}, {"slide": math.nan}, {"slide": HUGE}, {"slide": 99.0}],
    "by joint": [5, "ab", [1], {"slide": "1"}, {"slide": None}, {"slide": math.nan},
                 {"slide": HUGE}, {"slide": True}],
}  # fmt: skip


def _longer(first, values):
    """The same faults in a list that is as long as it is to be; and lists that are not."""
    return [[*first, *v] if isinstance(v, list | np.ndarray) else v for v in values]


BAD["turn"] = _longer([1], BAD["place"])
BAD["pose"] = _longer([1, 0, 0, 0], BAD["place"])
BAD["one"] = BAD["above 0"]
BAD["setting"] = BAD["seconds above 0"]
BAD["bool"] = [*BAD["flag"], 0, 1]
BAD["port"] = [*BAD["steps"], 65536]
BAD["index"] = [*BAD["count"], 5, HUGE]
BAD["id"] = [*BAD["count"], 10**6, HUGE]
BAD["limit"] = [v for v in BAD["seconds above 0"] if v not in (math.inf, HUGE)]
BAD["speed"] = [v for v in BAD["seconds above 0"] if not isinstance(v, bool)]
BAD["inside"] = [*BAD["time"], -0.1, 3]
BAD["text"] = [v for v in NO_NUMBERS if not isinstance(v, str)] + [0, 0.5, b"a"]
OPTIONAL = {kind: [v for v in values if v is not None] for kind, values in BAD.items()}
GOOD = {
    "steps": [0, 1, np.int64(1), np.uint8(1)],
    "count": [0, 1, np.int32(2)],
    "above 0": [1, np.int64(2)],
    "pixels": [1, np.int16(9)],
    "seconds": [0, 0.01, np.float32(0.01), np.int64(0), Fraction(1, 100)],
    "seconds above 0": [1, 0.5, np.float32(2), Fraction(1, 2)],
    "flag": [True, False, 0, 1, np.bool_(0), np.int64(1)],
    "place": [[0, 0, 1], (0.0, 0, 1), np.array([0, 0, 1]), np.array([0, 0, 1.0], dtype="f4")],
    "joints": [[0.1], (np.float32(0.1),), np.array([0.1]), {"slide": 0}, {}],
    "by joint": [{"slide": 0.1}, {"slide": np.int64(0)}],
    "turn": [[1, 0, 0, 0], np.array([0, 0, 0, 1.0])],
    "pose": [[1, 0, 0, 0, 0, 0, 1], np.array([2.0, 0, 0, 1, 0, 0, 1])],
    "one": [1, np.int64(1)],
    "setting": [1, 0.5, np.float32(2)],
    "bool": [True, False],
    "index": [0, np.int64(0)],
    "port": [0, np.int64(0)],
    "limit": [1, np.float32(0.5), math.inf],
    "speed": [True, 1000, np.float32(1000)],
    "inside": [0, 1.5, np.float32(0.5)],
    "time": [],
    "text": [],
    "id": [],
}
ARM = """<robot name="arm">
<link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
 iyz="0"/></inertial></link>
<link name="hand"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
 iyz="0"/></inertial></link>
<joint name="slide" type="prismatic"><parent link="base"/><child link="hand"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


def trigger(t, **terms):
    t.ss.add_trigger("t", "1;", **{"interval": 0, "callback": print, **terms})
    t.ss.del_trigger("t")


def occupied(**arguments):
    return grids.OccupancyGrid(np.zeros((2, 2), dtype=bool), (0.0, 0.0), 1.0, **arguments)


# Of each argument: what it is expected to be, whether None is fine, and the call.
CALLS = {
    "World.step(count)": ("steps", False, lambda t, v: t.sim.step(v)),
    "World.step(every)": ("above 0", True, lambda t, v: t.sim.step(0, every=v)),
    "World.batch(count)": ("above 0", False, lambda t, v: ssduck.World.batch(t.sim, v)),
    "World.batch(history)": ("steps", False, lambda t, v: ssduck.World.batch(t.sim, 1, history=v)),
    "World.tick(steps)": ("steps", True, lambda t, v: t.sim.tick(steps=v)),
    "World.tick(time)": ("time", True, lambda t, v: t.sim.tick(time=v)),
    "World.run(seconds)": ("seconds", False, lambda t, v: t.sim.run(v)),
    "World.run(realtime)": ("speed", False, lambda t, v: t.sim.run(0, realtime=v)),
    "World.run(progress)": ("flag", False, lambda t, v: t.sim.run(0, progress=v)),
    "World.run(every)": ("above 0", True, lambda t, v: t.sim.run(0, every=v)),
    "World.render(width)": ("pixels", False, lambda t, v: t.sim.render(v, 2)),
    "World.render(height)": ("pixels", False, lambda t, v: t.sim.render(2, v)),
    "World.render(shadow)": ("flag", False, lambda t, v: t.sim.render(2, 2, shadow=v)),
    "World.segmentation(width)": ("pixels", False, lambda t, v: t.sim.segmentation(v, 2)),
    "World.segmentation(height)": ("pixels", False, lambda t, v: t.sim.segmentation(2, v)),
    "World.segmentation(links)": ("flag", False, lambda t, v: t.sim.segmentation(2, 2, links=v)),
    "World.entity(id)": ("id", False, lambda t, v: t.sim.entity(v)),
    "World.what_if(poses)": ("pose", False, lambda t, v: t.sim.what_if({"ball": v})),
    "World.what_if(joints)": ("joints", False, lambda t, v: t.sim.what_if(joints={"arm": v})),
    "World.add_sensor(position)": (
        "place", False, lambda t, v: t.sim.remove_sensor(_eye(t, position=v))
    ),
    "World.add_sensor(orientation)": (
        "turn", False,
        lambda t, v: t.sim.remove_sensor(_eye(t, orientation=v)),
    ),
    "World.add_sensor(settings)": (
        "setting", False, lambda t, v: t.sim.remove_sensor(_eye(t, max_range=v))
    ),
    "World.CloneSelf(options)": ("count", False, lambda t, v: t.sim.CloneSelf(v).close()),
    "World.attach(names)": ("text", True, lambda t, v: ssduck.World.attach(t.client, names={0: v})),
    "World.attach(kinds)": ("text", True, lambda t, v: ssduck.World.attach(t.client, kinds={0: v})),
    "Entity.move(position)": ("place", True, lambda t, v: t.ball.move(v)),
    "Entity.move(orientation)": ("turn", True, lambda t, v: t.ball.move(orientation=v)),
    "Entity.move(wxyz)": ("turn", True, lambda t, v: t.ball.move(wxyz=v)),
    "Entity.move(xyzw)": ("turn", True, lambda t, v: t.ball.move(xyzw=v)),
    "Entity.move(joints)": ("joints", True, lambda t, v: t.arm.move(joints=v)),
    "Entity.drive(positions)": ("joints", True, lambda t, v: t.arm.drive(v)),
    "Entity.drive(velocities)": ("by joint", True, lambda t, v: t.arm.drive(velocities=v)),
    "Entity.drive(efforts)": ("by joint", True, lambda t, v: t.arm.drive({"slide": 0}, efforts=v)),
    "Entity.hold(touching)": ("one", False, lambda t, v: t.held(v)),
    "Entity.enabled": ("flag", False, lambda t, v: setattr(t.ball, "enabled", v)),
    "Entity.visible": ("flag", False, lambda t, v: setattr(t.ball, "visible", v)),
    "Entity.Enable(enable)": ("flag", False, lambda t, v: t.ball.Enable(v)),
    "Entity.SetVisible(visible)": ("flag", False, lambda t, v: t.ball.SetVisible(v)),
    "Entity.SetDOFValues(values)": ("joints", False, lambda t, v: t.arm.SetDOFValues(v)),
    "Entity.SetDOFValues(dofindices)": (
        "index", False, lambda t, v: t.arm.SetDOFValues([0.1], [v])
    ),
    "Entity.SetTransform(transform)": ("pose", False, lambda t, v: t.ball.SetTransform(v)),
    "Sensor.power(on)": ("flag", False, lambda t, v: t.eye.power(v)),
    "Interpreter(row_by_row)": (
        "flag", False, lambda _, v: ssduck.Interpreter(row_by_row=v).close()
    ),
    "Interpreter(strict)": ("flag", False, lambda _, v: ssduck.Interpreter(strict=v).close()),
    "Interpreter.strict": ("flag", False, lambda t, v: setattr(t.ss, "strict", v)),
    "Interpreter.run(seconds)": ("seconds", False, lambda t, v: t.ss.run(v)),
    "Interpreter.run(realtime)": ("speed", False, lambda t, v: t.ss.run(0, realtime=v)),
    "Interpreter.run(progress)": ("flag", False, lambda t, v: t.ss.run(0, progress=v)),
    "Interpreter.view(port)": ("port", False, lambda t, v: t.ss.view(port=v).close()),
    "Interpreter.run(every)": ("above 0", True, lambda t, v: t.ss.run(0, every=v)),
    "Interpreter.show(rows)": ("count", False, lambda t, v: t.ss.show("[1, 2];", v)),
    "Result.part(start)": ("count", False, lambda t, v: t.ss.sql("SELECT 1").part(v, 1)),
    "Result.part(count)": ("count", False, lambda t, v: t.ss.sql("SELECT 1").part(0, v)),
    "Result.show(rows)": ("count", True, lambda t, v: t.ss.sql("SELECT 1").show(rows=v)),
    "Result.show(width)": ("above 0", True, lambda t, v: t.ss.sql("SELECT 1").show(width=v)),
    "TableView.text(width)": ("above 0", True, lambda t, v: t.ss.sql("SELECT 1").__rich__().text(v)),
    "Interpreter.past(age)": ("time", True, lambda t, v: t.ss.past("sim", v)),
    "Interpreter.export(start)": ("time", True, lambda t, v: t.ss.export(t.path, start=v)),
    "Interpreter.export(pairs)": ("seconds", True, lambda t, v: t.ss.export(t.path, start=t.sim.time, pairs=v)),
    "Interpreter.export(end)": ("time", True, lambda t, v: t.ss.export(t.path, end=v)),
    "Interpreter.add_trigger(interval)": ("seconds", False, lambda t, v: trigger(t, interval=v)),
    "Interpreter.add_trigger(debounce)": ("seconds", False, lambda t, v: trigger(t, debounce=v)),
    "Interpreter.add_trigger(threshold)": ("seconds", False, lambda t, v: trigger(t, threshold=v)),
    "Interpreter.add_trigger(rows)": ("bool", False, lambda t, v: trigger(t, rows=v)),
    "Interpreter.add_trigger(queue)": ("above 0", True, lambda t, v: trigger(t, queue=v)),
    "Result.fetchmany(size)": ("count", False, lambda t, v: t.ss.sql("SELECT 1").fetchmany(v)),
    "TableView(rows)": ("count", False, lambda _, v: TableView([1, 2], v)),
    "Past.at(tick)": ("id", False, lambda t, v: t.ss.past("sim").at(v)),
    "ReplayedWorld.seek(time)": ("time", False, lambda t, v: t.recorded.seek(v)),
    "Limits(seconds)": ("limit", True, lambda _, v: ssduck.Limits(seconds=v)),
    "Limits(rows)": ("above 0", True, lambda _, v: ssduck.Limits(rows=v)),
    "Limits(memory)": ("above 0", True, lambda _, v: ssduck.Limits(memory=v)),
    "Limits(answer_bytes)": ("above 0", False, lambda _, v: ssduck.Limits(answer_bytes=v)),
    "Limits(depth)": ("above 0", False, lambda _, v: ssduck.Limits(depth=v)),
    "Limits(eval)": ("flag", False, lambda _, v: ssduck.Limits(eval=v)),
    "Limits(files)": ("flag", False, lambda _, v: ssduck.Limits(files=v)),
    "Limits(select_only)": ("flag", False, lambda _, v: ssduck.Limits(select_only=v)),
    "Limits(progress)": ("flag", False, lambda _, v: ssduck.Limits(progress=v)),
    "Recording(every)": ("above 0", False, lambda _, v: ssduck.Recording(every=v)),
    "Recording(changed)": ("flag", False, lambda _, v: ssduck.Recording(changed=v)),
    "Recording(seconds)": ("seconds above 0", True, lambda _, v: ssduck.Recording(seconds=v)),
    "Recording(flush_every)": (
        "seconds above 0",
        True,
        lambda _, v: ssduck.Recording(flush_every=v),
    ),
    "Recording(ticks)": ("above 0", True, lambda _, v: ssduck.Recording(ticks=v)),
    "Recording(max_bytes)": ("above 0", True, lambda _, v: ssduck.Recording(max_bytes=v)),
    "OccupancyGrid.at(point)": ("inside", False, lambda _, v: occupied().at(v, 0.5)),
    "OccupancyGrid.centres(axis)": ("index", False, lambda _, v: occupied().centres(v)),
    "OccupancyGrid.load(unknown)": (
        "flag", True, lambda t, v: grids.OccupancyGrid.load(t.map, unknown=v)
    ),
    "Lake.ask(processes)": ("above 0", True, lambda t, v: t.lake.ask("1;", processes=v)),
    "Lake.ask(batch)": ("above 0", True, lambda t, v: t.lake.ask("1;", batch=v, processes=1)),
    "Lake.ask(progress)": ("flag", False, lambda t, v: t.lake.ask("1;", progress=v, processes=1)),
    "Lake.ask(strict)": ("flag", False, lambda t, v: t.lake.ask("1;", strict=v, processes=1)),
    "Lake.lint(strict)": ("flag", False, lambda t, v: t.lake.lint("1 > 0;", strict=v, processes=1)),
    "Lake.tag(strict)": ("flag", False, lambda t, v: t.lake.tag("n", "1;", strict=v, processes=1)),
    "Lake.refresh(forget_missing)": ("flag", False, lambda t, v: t.lake.refresh(forget_missing=v)),
    "open(episode)": ("id", True, lambda t, v: ssduck.open(t.record, episode=v)),
}  # fmt: skip

# Arguments that are numbers and not in `CALLS`: what results are made of, what is called by
# ssduck and not by users, and what is another entry's.
OTHERS = {
    "Entity(id)": "made by worlds", "Link(id)": "made by worlds",
    "Damage": "a result",
    "Episode": "a result",
    "Past": "a result; `Interpreter.past` makes it",
    "OccupancyGrid": "a result", "Grid": "a result", "SensorGrid": "a result",
    "PlaneGrid": "a result", "VoxelGrid": "a result", "Selection": "handed to adapters",
    "World.reading": "Sensor.reading",
    "World.attach(forward)": "of MuJoCo, tests/simulators/mujoco", "World.reached": "for followers",
    "World.handle(id)": "of a row", "World.steps_to_tick": "a part of step",
    "World(simulator)": "made by load and attach", "Interpreter.keep": "a part of programs",
    "Interpreter.addTrigger": "Interpreter.add_trigger",
    "Lake.score": "Lake.ask", "Lake.stream": "Lake.ask", "RecordWriter.begin": "for its subclass",
    "ReplayedWorld.seek_tick": "for scoring",
}  # fmt: skip

# Those whose messages name the step, the setting, the age, the joint or the pose.
NAMED_OTHERWISE = {
    "World.step(count)", "World.what_if(poses)", "World.what_if(joints)",
    "World.add_sensor(settings)", "World.attach(kinds)", "Interpreter.export(start)",
    "Interpreter.export(end)", "OccupancyGrid.at(point)",
    *(f"Entity.move({argument})" for argument in ("wxyz", "xyzw", "joints")),
    *(f"Entity.drive({argument})" for argument in ("positions", "velocities", "efforts")),
    *(f"Entity.SetDOFValues({argument})" for argument in ("values", "dofindices")),
    "Entity.SetTransform(transform)",
}  # fmt: skip


def _eye(t, **settings):
    return t.sim.add_sensor("range_finder", "ball", **{"max_range": 1.0, **settings})


class Things:
    """What the functions are called on: an attached client with an arm and balls, a record."""

    def __init__(self, folder):
        self.client = pybullet.connect(pybullet.DIRECT)
        (folder / "arm.urdf").write_text(ARM)
        names = {
            solid(self.client, pybullet.GEOM_SPHERE, 1, radius=0.1): "ball",
            solid(self.client, pybullet.GEOM_SPHERE, 1, [0, 0, 0.2], radius=0.1): "other",
            pybullet.loadURDF(
                str(folder / "arm.urdf"), [9, 9, 9], physicsClientId=self.client
            ): "arm",
        }
        self.sim = ssduck.World.attach(self.client, names=names)
        self.ss = ssduck.Interpreter()
        self.ss.add_variable("sim", self.sim)
        self.ball, self.arm = self.sim["ball"], self.sim["arm"]
        self.eye = self.sim.add_sensor("range_finder", "arm", max_range=1.0)
        self.path, self.record = folder / "exported", folder / "record"
        self.ss.export(self.record)
        self.opened = ssduck.open(self.record)
        self.lake = ssduck.lake(self.record)
        self.recorded = self.opened.call_variable("sim")
        self.map = occupied().save(folder / "map.yaml")

    def held(self, touching):
        self.sim["other"].move([0, 0, 0.2])
        self.ball.move([0, 0, 0])
        self.ball.hold(self.sim["other"], touching=touching)
        self.ball.release(self.sim["other"])

    def state(self):
        """What must not change by a call that fails."""
        poses = [entity.pose for entity in self.sim]
        joints = pybullet.getJointState(2, 0, self.client)[:2]
        flags = self.ball.enabled, self.ball.visible, self.eye.powered, self.path.exists()
        return self.sim.time, poses, joints, flags, len(self.sim), len(self.ss.triggers())

    def close(self):
        self.opened.close()
        self.ss.close()
        pybullet.disconnect(self.client)


@pytest.fixture(scope="module")
def things(tmp_path_factory):
    made = Things(tmp_path_factory.mktemp("numbers"))
    yield made
    made.close()


@pytest.mark.parametrize("name", CALLS)
def test_a_number_of_the_wrong_kind(things, name):
    kind, is_optional, call = CALLS[name]
    values = (OPTIONAL if is_optional else BAD)[kind]
    argument = name.partition("(")[2].rstrip(")")
    things.held(1)
    before = things.state()
    for value in values:
        with pytest.raises(SelectScriptError) as raised:
            call(things, value)
        kinds = TypeError | ValueError | LookupError | ArithmeticError | OSError
        assert isinstance(raised.value, kinds) or kind == "text", value
        assert len(str(raised.value)) < 1000
        assert argument in str(raised.value) or name in NAMED_OTHERWISE
    assert things.state() == before


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:arm. the motors are")
@pytest.mark.parametrize("name", CALLS)
def test_a_number_of_the_right_kind(things, name):
    """numpy's numbers are as good as Python's, and None is where it stands for something."""
    kind, is_optional, call = CALLS[name]
    for value in (*GOOD[kind], *([None] if is_optional and kind not in ("text", "time") else [])):
        call(things, value)


def test_no_public_function_is_without_cases():
    """By its annotations: whatever takes a number or a flag, or several."""
    classes = [ssduck.__getattr__(name) for name in ssduck.__all__]
    classes = [value for value in classes if inspect.isclass(value)]
    classes += [ReplayedWorld, Result, TableView, ssduck.World, grids.Grid, grids.SensorGrid]
    seen = set()
    for owner in dict.fromkeys(classes):
        for name, member in inspect.getmembers(owner):
            if name.startswith("_") and name != "__init__":
                continue
            function = member.fset if isinstance(member, property) else member
            if not inspect.isroutine(function) or function in seen:
                continue
            seen.add(function)
            home = _home(owner, name)
            called = home if name == "__init__" else f"{home}.{name}"
            for argument in _numbers(function):
                case = called if isinstance(member, property) else f"{called}({argument})"
                assert case in CALLS or case in OTHERS or called in OTHERS or home in OTHERS, (
                    f"{case}: a public function takes a number; give it cases"
                )


def _home(owner, name):
    """The class of a handle that users know, in whose family it is defined."""
    for base in (ssduck.Sensor, ssduck.Entity, ssduck.World, ssduck.Interpreter):
        if issubclass(owner, base) and hasattr(base, name):
            shared = base is ssduck.Sensor and hasattr(ssduck.Entity, name)
            if name != "__init__" and not shared:
                return base.__name__
    return owner.__name__


def _numbers(function):
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return []
    pattern = r"\b(int|float|bool|ArrayLike|JointValues)\b"
    return [p.name for p in parameters if re.search(pattern, str(p.annotation))]


OPTIONS = [
    *(["query", "chaos", "--steps", bad, "1;"] for bad in ("-1", "0.5", "x", "nan", "1" * 30)),
    *(
        [command, "chaos", *more, "--seconds", bad]
        for command, more in (("query", ["1;"]), ("record", ["-o", "run"]))
        for bad in ("-1", "x", "nan", "inf", "1e300", "1e10")
    ),
    *(["record", "chaos", "-o", "run", "--seconds", "0", "--every", n] for n in ("0", "-1", "0.5")),
    *(["query", "record", "--episode", bad, "1;"] for bad in ("-1", "0.5", "x", "7")),
    *(
        ["export", "record", "-o", "run", option, bad]
        for option in ("--start", "--end")
        for bad in ("nan", "inf", "x", "1e400")
    ),
    ["export", "record", "-o", "run", "--episode", "-1"],
    *(["demo", "chaos", "--seed", bad] for bad in ("-1", "0.5", "x")),
]


@pytest.mark.slow
@sampled("arguments", OPTIONS, every=4, ids=" ".join)
def test_a_number_on_the_command_line(things, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "record").symlink_to(things.record)
    result = CliRunner().invoke(app, arguments, prog_name="ssduck")
    assert result.exit_code in (1, 2)
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    assert isinstance(result.exception, SystemExit)
    assert [path.name for path in tmp_path.iterdir()] == ["record"]


@pytest.mark.parametrize(
    "command",
    [
        "SetSize 0 1 0.1", "SetSize nan 1 0.1", "SetSize inf 1 0.1", "SetSize 1.5 1 0.1",
        "SetSize 1 1 inf", "SetSize 1e6 1e6 0.1", "SetSize 1 1", "SetSize a b c",
        "SetTranslation nan 0 0", "SetTranslation 0 inf 0", "SetTranslation 1", "Scan",
    ],
)  # fmt: skip
def test_commands_of_the_occupancy_grid(things, command):
    with pytest.raises(SelectScriptError, match=r"^occupancygridmap: "):
        OccupancyGridMap(things.sim).SendCommand(command)
