"""The models that gymnasium comes with: links, joints, contact forces, and copies."""

from pathlib import Path

import numpy as np
import pytest

import ssduck

mujoco = pytest.importorskip("mujoco")
gymnasium = pytest.importorskip("gymnasium")
ASSETS = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(path.name for path in ASSETS.glob("*.xml")))
def test_a_model_of_gymnasium(name):
    model = mujoco.MjModel.from_xml_path(str(ASSETS / name))
    data = mujoco.MjData(model)
    world = ssduck.World.attach(model, data)
    data.ctrl[:] = np.random.default_rng(0).uniform(-0.3, 0.3, model.nu)
    mujoco.mj_step(model, data, 200)
    world.tick()
    world.request_tables(["links", "joints", "shapes", "contacts"])
    tables = world.snapshot.tables
    roots = [info.body.handle for info in world.snapshot.entities]
    described = [n for n in range(model.nbody) if model.body_rootid[n] in roots]
    is_site = np.array(
        [region is not None for region in tables["links"].arrow["region"].to_pylist()]
    )
    poses = tables["links"].doubles("x", "z").T
    assert np.array_equal(poses[~is_site], data.xpos[described])
    assert np.array_equal(np.sort(poses[is_site], axis=0), np.sort(data.site_xpos, axis=0))
    assert len(tables["joints"]["entity"]) == model.njnt
    forces = np.zeros((data.ncon, 6))
    for number, force in enumerate(forces):
        mujoco.mj_contactForce(model, data, number, force)
    assert tables["contacts"]["force"].sum() == pytest.approx(forces[:, 0].sum(), abs=1e-9)
    copy = world.excerpt(world)
    copy.step(20)
    mujoco.mj_step(model, data, 20)
    assert np.array_equal(copy.simulator.data.qpos, data.qpos)
    copy.close()
