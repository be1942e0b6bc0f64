"""A process of its own loads a stranger's scene first: what crashes it is an error here."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
import warnings
from contextlib import suppress
from pathlib import Path

import pytest

import ssduck
from ssduck import Limits
from ssduck.errors import LimitError, NumberError, SceneError, SimulatorError, UnsupportedError
from ssduck.gym import make_task
from ssduck.simulators import trial
from ssduck.simulators.scene_files import check_files_inside
from ssduck.simulators.scenes import find_scene
from tests.support.cases import generated, sampled
from tests.support.command_line import ssduck_
from tests.support.timing import HANGS
from tests.support.urdf import collision, joint, link, robot
from tools.fuzz_scenes import Fuzz
from tools.fuzzing.models import DAE, FORMATS, VISUAL_MESH

# PyBullet looks for the geometry of no name; no check of ssduck knows of this.
CRASHING = DAE.replace('<instance_geometry url="#g"/>', "<instance_geometry/>", 1)
BOX = robot(link("base", shapes=collision('<box size="1 1 1"/>')))
CRASH = r"c\.urdf: PyBullet crashes on this file.*\(SIG[A-Z]+\)"
TEXTURE = '<material name="m"><texture filename="big.png"/></material>'
TASK = 'scene = "{}"\nsuccess = "z(sim.b) > 0"\n[observation]\nz = "z(sim.b)"\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a box, a model that crashes PyBullet, and scenes with both."""
    (tmp_path / "b.urdf").write_text(BOX)
    (tmp_path / "c.urdf").write_text(VISUAL_MESH % "c.dae")
    (tmp_path / "c.dae").write_text(CRASHING)
    bodies = ('[[body]]\nname="b"\nurdf="b.urdf"\n', '[[body]]\nname="c"\nurdf="c.urdf"\n')
    (tmp_path / "scene.toml").write_text('name="lab"\n' + "".join(bodies))
    (tmp_path / "good.toml").write_text('name="lab"\n' + bodies[0])
    (tmp_path / "task.toml").write_text(TASK.format("good.toml"))
    (tmp_path / "crashing.toml").write_text(TASK.format("scene.toml"))
    return tmp_path


@pytest.mark.slow
def test_a_crash_is_an_error_that_names_the_file(folder: Path) -> None:
    for name in ("c.urdf", "scene.toml"):
        with pytest.raises(SceneError, match=CRASH):
            ssduck.load(folder / name, limits=Limits.strict().in_process)
    with ssduck.load(folder / "good.toml", limits=Limits.strict().in_process) as ss:
        assert ss.eval("SELECT id FROM lab AS list;") == ["b"]


@pytest.mark.slow
def test_a_file_of_any_size_is_not_read_to_see_whether_it_changes(folder: Path) -> None:
    (folder / "b.urdf").write_text(BOX.replace("</robot>", TEXTURE + "</robot>"))
    with (folder / "big.png").open("wb") as file:
        file.truncate(1 << 40)  # no bytes on the disk
    with ssduck.load(folder / "good.toml", limits=Limits.strict().in_process) as ss:
        assert ss.eval("SELECT id FROM lab AS list;") == ["b"]
        (found,) = [
            each
            for each in check_files_inside(find_scene(folder / "good.toml"))
            if each.name == "big.png"
        ]
        assert found == folder.resolve() / "big.png"


@pytest.mark.long
def test_a_crash_in_a_task_an_agent_and_a_command(folder: Path) -> None:
    with pytest.raises(SceneError, match=CRASH):
        make_task(folder / "crashing.toml")
    done = ssduck_("query", str(folder / "c.urdf"), "1;", "--strict")
    assert done.exit_code == 1
    assert "PyBullet crashes on this file" in done.output


@pytest.mark.slow
def test_errors_are_those_of_loading(folder: Path) -> None:
    model = robot(link("a"), link("b"), joint("door", "revolute", "a", "b"))
    (folder / "door.urdf").write_text(model)
    (folder / "none.xml").write_text("<mujoco><worldbody>")
    scenes = {
        "joint": '[[body]]\nname="b"\nurdf="door.urdf"\njoints={dor=1}\n',
        "constraint": '[[body]]\nname="b"\nurdf="b.urdf"\n[[constraint]]\ntype="fixed"\non="b"\n'
        'link="bas"\n',
        "simulator": 'simulator="mujoco"\n[[body]]\nname="b"\nsdf="b.sdf"\n',
        "mjcf": '[[body]]\nmjcf="none.xml"\n',
    }
    for name, text in scenes.items():
        (folder / f"{name}.toml").write_text(text)
        errors = []
        for limits in (Limits.strict(trial=False).in_process, Limits.strict().in_process):
            with pytest.raises((SceneError, UnsupportedError)) as raised:
                ssduck.load(folder / f"{name}.toml", limits=limits)
            errors.append((type(raised.value), raised.value.message, raised.value.suggestions))
        assert errors[0] == errors[1]
    assert errors[0][1]


@pytest.mark.slow
def test_warnings_come_once(folder: Path) -> None:
    (folder / "plane.urdf").write_text(robot(link("base"), '<transmission name="t"/>'))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        ssduck.load(folder / "plane.urdf", limits=Limits.strict().in_process).close()
    with warnings.catch_warnings(record=True) as alone:
        warnings.simplefilter("always")
        ssduck.load(folder / "plane.urdf").close()
    assert [str(each.message) for each in told] == [str(each.message) for each in alone]


# -- which scenes, and how often ---------------------------------------------------------------


@pytest.fixture
def tried(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the scenes that were tried."""
    names: list[str] = []
    real = trial._try

    def counted(request):
        names.append(request.scene.path.name)
        real(request)

    monkeypatch.setattr(trial, "_try", counted)
    return names


@pytest.mark.slow
def test_limits_say_whether_there_is_a_trial(folder: Path, tried: list[str]) -> None:
    for limits in (
        None,
        Limits(),
        Limits.strict(trial=False).in_process,
        Limits.strict(files=True).in_process,
    ):
        ssduck.load(folder / "good.toml", limits=limits).close()
    ssduck.load("hall", limits=Limits.strict().in_process).close()
    assert tried == []
    for limits in (Limits(trial=True), Limits(files=False), Limits.strict(seconds=1).in_process):
        ssduck.load(folder / "good.toml", limits=limits).close()
    assert tried == ["good.toml"] * 3
    with pytest.raises(SceneError, match=CRASH):
        ssduck.load(folder / "scene.toml", limits=Limits(trial=True))
    with pytest.raises((TypeError, NumberError)):
        Limits(trial="yes")


@pytest.mark.slow
def test_a_task_tries_its_scene_again_if_a_file_is_another(folder: Path, tried: list[str]) -> None:
    env = make_task(folder / "task.toml")
    for _ in range(3):
        env.reset()
    assert tried == ["good.toml"]
    (folder / "b.urdf").write_text(BOX.replace("1 1 1", "1 1 2"))
    env.reset()
    assert tried == ["good.toml"] * 2
    (folder / "b.urdf").write_text(VISUAL_MESH % "c.dae")
    with pytest.raises(SceneError, match=r"b\.urdf: PyBullet crashes"):
        env.reset()
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("moment", ["trial", "loading"])
def test_files_that_change_meanwhile(
    folder: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    """A link to another file, and a file that appears, count, too."""
    (folder / "other.dae").write_text(DAE)
    (folder / "c.dae").unlink()
    (folder / "c.dae").symlink_to("other.dae")
    target, name = (trial, "_try") if moment == "trial" else (ssduck.world.World, "load")
    real = getattr(target, name)

    def change(*arguments, **options):
        result = real(*arguments, **options)
        (folder / "c.dae").unlink()
        (folder / "c.dae").write_text(DAE.replace("0 0 1 90", "0 0 1 91"))
        return result

    monkeypatch.setattr(target, name, change)
    with pytest.raises(SceneError, match=r"c\.dae has changed while .*c\.urdf was loaded"):
        ssduck.load(folder / "c.urdf", limits=Limits.strict().in_process, simulator="pybullet")


# -- what the process may do -----------------------------------------------------------------


def told(monkeypatch: pytest.MonkeyPatch, *lines: str, then: str = "") -> None:
    """Lets another process than the real one tell so."""
    code = f"import sys, os, time\nfor line in {lines!r}: print(line, flush=True)\n{then}"
    monkeypatch.setattr(trial, "python_command", lambda _: [sys.executable, "-c", code])


BEGINS, LOADED = '{"begins": true}', '{"loaded": true}'
SIGNAL = "os.kill(os.getpid(), 6)"
# It keeps the pipe of the process, which ends.
GRANDCHILD = (
    "import subprocess\ncode = 'import time; time.sleep(20)'\n"
    "subprocess.Popen([sys.executable, '-c', code], start_new_session=True)"
)
TOLD = [
    ((), "", SimulatorError, r"loads .*b\.urdf first did not start: exit status 0"),
    ((), SIGNAL, SimulatorError, r"did not start: SIGABRT"),
    ((BEGINS,), GRANDCHILD, LimitError, "loading takes more than 0.2 s"),
    ((BEGINS,), SIGNAL, SceneError, r"b\.urdf: PyBullet crashes on this file.*SIGABRT"),
    ((BEGINS, LOADED), SIGNAL, SceneError, r"crashes when this scene runs.*SIGABRT"),
    ((BEGINS, '{"reads": "m.urdf"}'), SIGNAL, SceneError, r"^m\.urdf: PyBullet crashes"),
    ((BEGINS, BEGINS), "time.sleep(60)", SceneError, "crashes on this file"),
    ((BEGINS, "nonsense"), "time.sleep(60)", SceneError, "crashes on this file"),
    ((BEGINS, '{"passed": 1, "x": '), "", SceneError, "crashes on this file"),
    ((BEGINS, "[" * 70_000), "time.sleep(60)", SceneError, "crashes on this file"),
    ((BEGINS, '{"error": "no", "type": "SystemExit", "suggestions": []}'), "", SceneError, "^no$"),
    ((BEGINS, '{"error": 1, "type": "x", "suggestions": 2}'), "", SceneError, "crashes"),
    ((BEGINS,), "time.sleep(60)", LimitError, "loading takes more than 0.2 s"),
    ((BEGINS,), "while True: print(sys.argv, flush=True)", SceneError, "crashes"),
]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
@pytest.mark.parametrize(("lines", "then", "error", "message"), TOLD)
def test_nothing_that_a_taken_process_tells_is_believed(
    folder: Path, monkeypatch: pytest.MonkeyPatch, lines, then, error, message
) -> None:
    told(monkeypatch, *lines, then=then)
    monkeypatch.setattr(trial, "LEAST_LOADING", 0.0)
    limits = Limits.strict(seconds=0.2).in_process
    with pytest.raises(error, match=message):
        ssduck.load(folder / "b.urdf", limits=limits, simulator="pybullet")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends it with its parent")
@sampled("end", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT], every=3)
def test_the_process_ends_with_its_parent(folder: Path, end: signal.Signals) -> None:
    pytest.importorskip("mujoco")
    bodies = '<replicate count="500" offset=".1 0 0"><geom size=".01"/></replicate>'
    world = f'<replicate count="900" offset="0 0 .1"><body><freejoint/>{bodies}</body></replicate>'
    (folder / "slow.xml").write_text(f"<mujoco><worldbody>{world}</worldbody></mujoco>")
    code = f"import ssduck; ssduck.load({str(folder / 'slow.xml')!r}, limits=ssduck.Limits(files=False))"
    with subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL) as parent:
        children = Path(f"/proc/{parent.pid}/task/{parent.pid}/children")
        found = waited_for(lambda: children.read_text().split())
        parent.send_signal(end)
    (child,) = found
    assert waited_for(lambda: not Path(f"/proc/{child}/exe").exists())


def waited_for(condition):
    """Returns what a condition gives as soon as it is true."""
    end = time.monotonic() + HANGS
    while time.monotonic() < end:
        with suppress(OSError):
            if result := condition():
                return result
        time.sleep(0.02)
    raise AssertionError("it did not happen")


@pytest.mark.parametrize("limits", [None, Limits.strict().in_process])
def test_an_unknown_simulator(folder: Path, limits: Limits | None) -> None:
    with pytest.raises(ssduck.SelectScriptError, match=r"no simulator 'pybulet'.*mean 'pybullet'"):
        ssduck.load(folder / "b.urdf", simulator="pybulet", limits=limits)


def test_a_process_that_does_not_start(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial, "python_command", lambda _: [str(folder / "no-python")])
    with pytest.raises(ssduck.SelectScriptError, match="no process can be started to load"):
        ssduck.load(folder / "b.urdf", limits=Limits.strict().in_process)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is limited on Linux")
def test_memory_is_limited(folder: Path) -> None:
    body = '<worldbody><geom size="1"/></worldbody>'
    (folder / "m.xml").write_text(f'<mujoco><size memory="3G"/>{body}</mujoco>')
    pytest.importorskip("mujoco")
    ssduck.load(folder / "m.xml", limits=Limits.strict(memory=3 * 10**9).in_process).close()
    with pytest.raises((SceneError, LimitError), match=r"memory|allocate"):
        ssduck.load(folder / "m.xml", limits=Limits.strict(memory=10**6).in_process)


# -- mutated files ---------------------------------------------------------------------------


@pytest.mark.slow
@sampled("format", FORMATS, every=len(FORMATS))
def test_no_mutated_file_ends_the_process(format: str, tmp_path: Path) -> None:
    """The short form of `python -m tools.fuzz_scenes`."""
    if format == "mujoco":
        pytest.importorskip("mujoco")
    fuzz = Fuzz()
    try:
        for seed in range(6, 6 + generated(2)):
            fuzz.add(format, seed)
    finally:
        fuzz.close()
    assert fuzz.faults == []
    assert any(text == "loaded" for _, text in fuzz.outcomes), json.dumps(list(fuzz.outcomes))
