"""`lifted(entity, height)`: how much higher an entity is than at the first recorded tick."""

import mujoco
import pytest

import ssduck
from ssduck.errors import SelectScriptError
from tests.support.gym_environments import PUSH


@pytest.fixture
def lab():
    model = mujoco.MjModel.from_xml_string(PUSH)
    data = mujoco.MjData(model)
    data.joint(model.body("ball").jntadr[0]).qpos[2] = 0.5  # so that sums are exact
    mujoco.mj_forward(model, data)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("lab", ssduck.World.attach(model, data))

        def put(height):
            data.joint(model.body("ball").jntadr[0]).qpos[2] = height
            data.time += model.opt.timestep
            mujoco.mj_forward(model, data)
            world.tick()

        yield ss, put


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rise", "expected"), [(0.0, False), (0.25 - 1e-9, False), (0.25, True), (0.5, True)]
)
def test_its_boundary_is_the_height(lab, rise, expected):
    ss, put = lab
    start = ss.eval("z(lab.ball);")
    put(0.7)  # only the first tick and the present one matter
    put(start + rise)
    rise = ss.eval("z(lab.ball);") - start
    assert ss.eval("lifted(lab.ball, 0.25);") is (rise >= 0.25) is expected
    assert ss.eval("SELECT id FROM lab WHERE lifted(this, 0.25) AS list;") == ["ball"] * expected
    assert ss.eval("lifted(lab.ball, 0);")


@pytest.mark.parametrize(
    ("program", "message"),
    [
        ("lifted(lab.ball);", "lifted"),
        ("lifted(lab.bal, 0.1);", "'ball'"),
        ("lifted(0.3, 0.1);", "lifted|entit"),
        ("lifted(lab.ball, 'high');", "high|text"),
    ],
)
def test_errors(lab, program, message):
    with pytest.raises(SelectScriptError, match=message):
        lab[0].eval(program)


def test_help_has_it(lab):
    assert "lifted(entity, height) -> bool" in lab[0].eval("help('lifted');")
