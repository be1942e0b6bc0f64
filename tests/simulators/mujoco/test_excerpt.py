"""Copies of MuJoCo worlds run as their originals, and those of some entities without the others."""

from copy import copy as copied

import numpy as np
import pytest

import ssduck
from ssduck.errors import UnsupportedError
from tests.support.mjcf import LAB, random_state, simulated

mujoco = pytest.importorskip("mujoco")


@pytest.fixture
def lab():
    model, data = simulated(LAB)
    data.qvel[:] = 0.3
    mujoco.mj_step(model, data, 100)
    return ssduck.World.attach(model, data), model, data


def test_a_copy_of_all_runs_as_the_original(lab):
    """To the last bit, and without a trace in the original."""
    world, model, data = lab
    kept = copied(data)
    with ssduck.Interpreter() as ss:
        ss.add_variable("lab", world)
        copy = ss.eval("SELECT obj(this) FROM lab AS environment;")
    assert copy.time == world.time
    copy.step(50)
    assert np.array_equal(data.qpos, kept.qpos)
    mujoco.mj_step(model, data, 50)
    assert np.array_equal(copy.simulator.data.qpos, data.qpos)
    assert np.array_equal(copy.simulator.data.qvel, data.qvel)
    assert copy.simulator.model is not model


def test_what_is_not_copied_is_not_there(lab):
    """Without its table the box falls to the floor; the others are in no table."""
    world, model, _ = lab
    world["box"].move([0, 0, 0.501])
    copy = world.excerpt(["world", "box"])
    assert [entity.name for entity in copy] == ["world", "box"]
    copy.run(2.0)
    assert copy["box"].position[2] == pytest.approx(0.1, abs=1e-3)
    copy.request_tables(["contacts"])
    assert {row["a"] for row in copy.snapshot.tables["contacts"].arrow.to_pylist()} == {
        copy["world"].id
    }
    assert model.geom_contype.tolist() == mujoco.MjModel.from_xml_string(LAB).geom_contype.tolist()


@pytest.mark.slow
def test_copies_of_past_and_assumed_ticks_are_at_their_poses(lab):
    world, model, data = lab
    random_state(model, data, 5)
    with ssduck.Interpreter(
        recording=ssduck.Recording(tables=("entities", "links", "joints"))
    ) as ss:
        ss.add_variable("lab", world)
        world.tick()
        expected = {entity.name: entity.pose for entity in world}
        links = world.snapshot.tables["links"].doubles("x", "wz").T.copy()
        at = world.time
        mujoco.mj_step(model, data, 200)
        world.tick()
        with pytest.warns(UserWarning, match="present controls"):
            copy = ss.eval(f"SELECT obj(this) FROM lab{{{at}}} AS environment;")
    assert copy.time == pytest.approx(at)
    copy.request_tables(["links"])
    found = copy.snapshot.tables["links"].doubles("x", "wz").T
    assert {e.name: pytest.approx(e.pose, abs=1e-9) for e in copy} == expected
    assert found[:, :3] == pytest.approx(links[:, :3], abs=1e-9)
    assert found[:, 7:] == pytest.approx(links[:, 7:], abs=1e-9)
    # The joints are a step ahead of MuJoCo's poses, unless a forward pass computes these.
    world = ssduck.World.attach(model, data, forward=True)
    moved = world.what_if({"ball": [1, 0, 0, 0, 7, 7, 7]}, {"arm": {"bend": 0.2}})
    with pytest.warns(UserWarning, match="present controls"):
        copy = moved.excerpt(moved)
    for name in ("ball", "arm", "box"):
        assert copy[name].pose == pytest.approx(moved[name].pose, abs=1e-9)


def test_models_that_are_gone_are_told():
    models = [
        (m, mujoco.MjData(m))
        for m in (mujoco.MjModel.from_xml_string(LAB.replace(".05", s)) for s in (".05", ".04"))
    ]
    made = models[:1]
    with ssduck.Interpreter() as ss:
        rebuilt = ss.add_variable("lab", ssduck.World.attach(lambda: made[-1]))
        before = rebuilt.what_if()
        made.append(models[1])
        rebuilt.tick()
        with pytest.raises(UnsupportedError, match=r"ball.*: MuJoCo's model is another one by now"):
            before.excerpt(["ball"])


@pytest.mark.slow
def test_records_have_no_model_of_mujoco(lab, tmp_path):
    """PyBullet runs copies of bodies without joints; of others it says what is missing."""
    world, model, data = lab
    with ssduck.Interpreter() as ss:
        ss.add_variable("lab", world)
        with ss.record_to(tmp_path / "run"):
            mujoco.mj_step(model, data)
            world.tick()
    pytest.importorskip("pybullet")
    with ssduck.open(tmp_path / "run") as ss:
        past = ss.call_variable("lab")
        with (
            pytest.warns(UserWarning, match="gravity and time step are not recorded"),
            pytest.warns(UserWarning, match="ball: only shapes, links, joints and masses"),
        ):
            copy = past.excerpt(["ball"])
        assert copy["ball"].position == pytest.approx(world["ball"].position, abs=1e-9)
        assert copy.simulator.backend == "pybullet"
        copy.close()
        with pytest.raises(UnsupportedError, match="arm has joints that PyBullet does not have"):
            past.excerpt(["arm"])
