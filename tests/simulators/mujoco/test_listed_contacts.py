"""Contacts that MuJoCo lists, whether they press or not: `hasContact`.

The oracle is MuJoCo's own list, as `check_contact` of the benchmarks reads it.
"""

import itertools

import mujoco
import pytest

import ssduck

# A bowl that falls on a soft plate and is lifted from it, and an arm whose two links may collide.
SCENE = """
<mujoco>
  <option timestep="0.004" cone="{cone}"/>
  <default><geom margin="{margin}" solref=".04 1"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 .1"/>
    <body name="plate" pos="0 0 .02"><freejoint/><geom type="box" size=".1 .1 .02" mass="1"/></body>
    <body name="bowl" pos="0 0 .08"><freejoint/>
      <geom type="box" size=".03 .03 .01" mass=".1"/><geom type="sphere" size=".02" pos="0 0 .02"/></body>
    <body name="arm" pos="1 0 .5"><geom type="box" size=".1 .1 .1"/>
      <body name="lower"><joint type="slide" axis="0 0 1"/><geom type="box" pos="0 0 .3" size=".1 .1 .02"/></body>
      <body name="upper"><joint type="slide" axis="0 0 1"/><geom type="box" pos="0 0 .5" size=".05 .05 .02"/></body>
    </body>
  </worldbody>
</mujoco>
"""


LINKS = ("arm.lower", "arm.upper")
ALL = ssduck.Recording(tables=("entities", "links", "contacts"))


class Lab:
    """The scene, and what MuJoCo lists in it."""

    def __init__(self, cone="elliptic", margin=0.0):
        self.model = mujoco.MjModel.from_xml_string(SCENE.format(cone=cone, margin=margin))
        self.data = mujoco.MjData(self.model)
        self.ss = ssduck.Interpreter(recording=ALL)
        self.world = ssduck.World.attach(self.model, self.data, {0: "floor"})
        self.ss.add_variable("lab", self.world)

    def step(self):
        mujoco.mj_step(self.model, self.data, 2)
        self.world.tick()

    def listed(self, one, other, *, of_entities=True):
        """Whether MuJoCo's list has a contact of two bodies, or of trees of bodies."""
        model = self.model
        numbers = [0 if name == "floor" else model.body(name).id for name in (one, other)]
        for contact in self.data.contact:
            bodies = model.geom_bodyid[contact.geom]
            if of_entities:
                bodies = model.body_rootid[bodies]
            if sorted(bodies) == sorted(numbers):
                return True
        return False


@pytest.fixture(params=["elliptic", "pyramidal"])
def lab(request):
    lab = Lab(request.param)
    yield lab
    lab.ss.close()


@pytest.mark.slow
def test_it_is_the_list_of_the_simulator_at_every_step(lab, tmp_path):
    """A bowl that is lifted meets the plate for some steps without pressing."""
    pairs = list(itertools.combinations(("floor", "plate", "bowl", "arm"), 2))
    columns = ", ".join(
        f"{relation}(lab.{a}, lab.{b})"
        for a, b in pairs
        for relation in ("hasContact", "inContact")
    )
    program = lab.ss.compile(f"SELECT {columns} FROM [0] AS list;")
    query = "SELECT hasContact(lab.plate, this) FROM lab WHERE id(this) == 'bowl' AS value;"
    record = lab.ss.record_to(tmp_path / "run", "lab", ALL)
    told, parting = [], 0
    for step in range(100):
        lab.data.xfrc_applied[lab.model.body("bowl").id, 2] = 0.0 if step < 60 else 1.6
        lab.step()
        values = lab.ss.eval(program)
        assert values[::2] == [lab.listed(*pair) for pair in pairs]
        listed, pressing = values[pairs.index(("plate", "bowl")) * 2 :][:2]
        assert listed or not pressing
        parting += listed and not pressing
        assert lab.ss.eval(query) is listed
        told.append(listed)
    assert parting
    assert not told[0]
    assert any(told[:-20])
    assert not told[-1]
    record.close()
    past = "SELECT hasContact(lab.bowl, this) FROM lab{} WHERE id(this) == 'plate' AS list;"
    rows = (
        "SELECT hasContact(a, b) FROM entities_history a JOIN entities_history b USING (tick) "
        "WHERE a.name = 'bowl' AND b.name = 'plate' ORDER BY tick"
    )
    with ssduck.open(tmp_path / "run") as opened:
        for ss in (lab.ss, opened):
            assert ss.eval(past)[-len(told) :] == told
            assert [one for (one,) in ss.sql(rows).fetchall()][-len(told) :] == told


def test_what_moves_apart_has_a_contact_and_does_not_press(lab):
    """So does an object that a gripper lifts, in the step in which it leaves its support."""
    lab.data.qpos[9], lab.data.qvel[8] = 0.0499, 0.25
    mujoco.mj_forward(lab.model, lab.data)
    lab.world.tick()
    assert lab.listed("plate", "bowl")
    program = "[hasContact(lab.plate, lab.bowl), inContact(lab.plate, lab.bowl)];"
    assert lab.ss.eval(program) == [True, False]
    assert lab.ss.eval("contactForce(lab.plate, lab.bowl);") == 0.0
    assert lab.ss.sql("SELECT force FROM contacts WHERE force = 0").fetchall()
    lab.data.qvel[8] = -0.25
    mujoco.mj_forward(lab.model, lab.data)
    lab.world.tick()
    assert lab.ss.eval(program) == [True, True]


@pytest.mark.slow
@pytest.mark.parametrize("relation", ["hasContact", "inContact", "grasped"])
def test_an_entity_is_in_no_contact_with_itself(lab, relation):
    """Contacts of its links are of these, now and in the past."""
    lab.data.qpos[-2:] = 0.0, -0.17
    mujoco.mj_forward(lab.model, lab.data)
    lab.world.tick()
    assert lab.listed("arm", "arm")
    assert lab.listed("lower", "upper", of_entities=False)
    for pair in itertools.permutations(LINKS, 2):
        one, other = (f"lab.{name}" for name in pair)
        assert lab.ss.eval(f"{relation}({one}, {other});") is (relation != "grasped")
    assert lab.ss.eval(f"{relation}(lab.arm, lab.arm);") is False
    assert lab.ss.eval(f"{relation}(lab.arm, lab.arm.lower);") is False
    for source in ("lab", "lab{}"):
        found = lab.ss.eval(f"SELECT id FROM {source} WHERE {relation}(this, this) AS list;")
        assert found == []
    for table in ("entities", "entities_history"):
        held = lab.ss.sql(f"SELECT name FROM {table} e WHERE {relation}(e, e)").fetchall()
        assert held == []


def test_contacts_within_a_margin_count_if_they_press():
    lab = Lab(margin=0.02)
    model, data = lab.model, lab.data
    data.qpos[9] = 0.06  # a gap of 1 cm between the plate and the bowl
    for speed, presses in ((3.0, False), (0.0, True)):
        data.qvel[8] = speed
        mujoco.mj_forward(model, data)
        lab.world.tick()
        assert lab.listed("plate", "bowl")
        bowl = model.body("bowl").id
        assert all(c.dist > 0 for c in data.contact if bowl in model.geom_bodyid[c.geom])
        program = "[hasContact(lab.plate, lab.bowl), inContact(lab.plate, lab.bowl)];"
        assert lab.ss.eval(program) == [presses, presses]
    lab.ss.close()
