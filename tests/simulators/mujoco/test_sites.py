"""Sites of MuJoCo: their poses are MuJoCo's, and relations take their regions as shapes."""

import itertools

import numpy as np
import pytest

import ssduck
from ssduck.schema import MASSES
from ssduck.sql.relations.registry import RELATIONS
from tests.support.cases import sampled
from tests.support.mjcf import simulated

mujoco = pytest.importorskip("mujoco")

FRAME = 'pos=".1 .05 .3" euler="10 20 30"'
REGIONS = {
    "sphere": ".15",
    "capsule": ".08 .1",
    "cylinder": ".1 .12",
    "box": ".2 .15 .1",
}
XML = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 .1"/>
    <site name="goal" pos="1 2 .5" size=".1"/>
    <body name="holder" pos="0 0 .1"><geom type="box" size=".3 .3 .02" pos="0 0 .05"/>{zone}</body>
    <body name="ball" pos=".1 .05 .4"><freejoint/><geom type="sphere" size=".05" mass="1"/></body>
    <body name="brick" pos=".1 .1 .62"><freejoint/><geom type="box" size=".1 .1 .04" mass="1"/></body>
    <body name="far" pos="1 0 .5"><freejoint/><geom type="box" size=".1 .1 .1" mass="1"/></body>
    <body name="arm" pos="2 0 1">
      <joint name="hinge" axis="0 0 1" pos="-.4 0 0"/>
      <geom type="box" size=".4 .02 .1"/>
      <body name="hand" pos=".5 0 0">
        <joint name="wrist" axis="1 0 0"/>
        <geom type="sphere" size=".05"/>
        <site name="grip" pos=".1 0 .1" euler="0 90 20"/>
        <site name="hand" pos=".2 0 0" type="capsule" size=".02 .1"/>
        <site pos=".2 .1 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
SITE = XML.format(zone=f'<site name="zone" type="box" size=".2 .15 .1" {FRAME}/>')


def world_of(xml):
    model, data = simulated(xml)
    ss = ssduck.Interpreter()
    ss.add_variable("lab", ssduck.World.attach(model, data))
    return ss, model, data


@pytest.fixture(scope="module")
def moved():
    """The world after it was moved and stepped."""
    ss, model, data = world_of(SITE)
    data.qvel[:] = np.linspace(-1, 1, model.nv)
    mujoco.mj_step(model, data, 30)
    mujoco.mj_forward(model, data)
    ss.call_variable("lab").tick()
    return ss, model, data


def test_poses_and_velocities_are_those_of_mujoco(moved):
    ss, model, data = moved
    lab = ss.call_variable("lab")
    owners = {"goal": "world", "zone": "holder", "grip": "arm"}
    for name, owner in owners.items():
        site, number = lab[owner].link(name), model.site(name).id
        assert site.position == pytest.approx(data.site_xpos[number], abs=1e-12)
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, data.site_xmat[number])
        assert abs(np.dot(site.orientation, quaternion)) == pytest.approx(1, abs=1e-9)
        twist = np.zeros(6)
        kind = mujoco.mjtObj.mjOBJ_SITE
        mujoco.mj_objectVelocity(model, data, kind, number, twist, 0)
        assert site.velocity == pytest.approx([*twist[3:], *twist[:3]], abs=1e-9)


def test_sites_are_values_beside_links(moved):
    ss = moved[0]
    names = ["world.goal", "holder.zone", "arm.grip", "arm.hand_site", "arm.site_4"]
    assert ss.eval("SELECT id FROM sites(lab) AS list;") == names
    assert ss.eval("SELECT name FROM sites(lab.arm) AS list;") == ["grip", "hand_site", "site_4"]
    assert ss.eval("SELECT id FROM links(lab.arm) AS list;") == ["arm.arm", "arm.hand"]
    assert ss.eval("[type(lab.arm.grip), type(lab.arm.hand)];") == ["site", "link"]
    assert ss.eval("id(parent(lab.arm.grip));") == "arm.hand"
    assert ss.eval("entity(lab.arm.grip) == lab.arm;") is True
    assert ss.eval("SELECT id FROM lab WHERE type(this) != 'sensor' AS list;") == [
        *("world", "holder", "ball", "brick", "far", "arm")
    ]
    with pytest.raises(ssduck.errors.UnknownNameError, match=r"no link or site 'gripp'.*'grip'"):
        ss.eval("lab.arm.gripp;")


@pytest.mark.slow
def test_the_table_has_forms_and_sizes(moved):
    ss = moved[0]
    rows = ss.sql("SELECT name, region, region_x, region_y, region_z FROM sites ORDER BY id")
    assert rows.fetchall()[:2] == [
        ("goal", "sphere", 0.1, 0.0, 0.0),
        ("zone", "box", 0.4, 0.3, 0.2),
    ]
    assert ss.sql("SELECT DISTINCT kind FROM links").fetchall() == [("link",)]
    joined = "SELECT l.name FROM sites s JOIN links l ON s.entity = l.entity AND s.parent = l.link"
    assert ss.sql(f"{joined} WHERE s.name = 'grip'").fetchall() == [("hand",)]


def test_an_entity_does_not_include_its_sites(moved):
    ss = moved[0]
    assert ss.call_variable("lab")["holder"].aabb[1][2] == pytest.approx(0.17)
    assert ss.call_variable("lab")["holder"].link("zone").mass == 0.0


# Relations that are not of shapes and poses alone.
OTHERS = {"isSensing", "sensing", "canSee"}
# The box of a body is aligned with the world, a region with its site.
OF_BOXES = {"within"}


@pytest.mark.slow
@sampled("form", REGIONS, every=4)
def test_relations_take_a_region_as_the_shape_of_a_link(form):
    """A link with the same shape, fixed to the same body, has the same answers."""
    inner = f'type="{form}" size="{REGIONS[form]}"'
    site, _, _ = world_of(XML.format(zone=f'<site name="zone" {inner} {FRAME}/>'))
    link, _, _ = world_of(
        XML.format(zone=f'<body name="zone" {FRAME}><geom {inner} mass="0"/></body>')
    )
    calls = []
    for name, relation in RELATIONS.items():
        required = relation.parameters[: relation.required_count]
        kinds = [parameter.type for parameter in required]
        reads = relation.inputs & {"contacts", "sensings", "joints", MASSES}
        if (
            kinds[:2] != ["entity", "entity"]
            or {*kinds[2:]} - {"double"}
            or reads
            or name in OTHERS | OF_BOXES
        ):
            continue
        numbers = ", 0.05" * (len(kinds) - 2)
        for pair in itertools.permutations(("lab.holder.zone", "X"), 2):
            for other in ("lab.ball", "lab.arm.hand") if form == "box" else ("lab.ball",):
                arguments = ", ".join(pair).replace("X", other)
                calls += [f"{name}({arguments}{numbers})"]
    assert len(calls) > 30
    program = f"[{', '.join(calls)}];"
    answers = zip(calls, site.eval(program), link.eval(program), strict=True)
    for call, of_site, of_link in answers:
        np.testing.assert_allclose(of_site, of_link, atol=1e-9, err_msg=call)


POINTS = {
    "sphere": ".1",
    "capsule": ".05 .1",
    "cylinder": ".08 .1",
    "box": ".2 .03 .1",
    "ellipsoid": ".2 .05 .1",
}


@pytest.mark.slow
@sampled("form", POINTS, every=3)
def test_a_position_in_a_region_that_is_turned(form):
    """Against NumPy, with the pose that MuJoCo gives a geom of the same form there."""
    inner = f'type="{form}" size="{POINTS[form]}" pos=".1 .05 .3" euler="10 20 40"'
    xml = (
        f"<mujoco><worldbody><geom name='zone' {inner}/><site name='zone' {inner}/>"
        "<body name='egg'><freejoint/><geom size='.001'/></body></worldbody></mujoco>"
    )
    ss, model, data = world_of(xml)
    zone, rng, answers = model.geom("zone").id, np.random.default_rng(1), []
    frame, other = data.geom_xmat[zone].reshape(3, 3), np.zeros(3)
    for place in rng.uniform(-0.1, 0.1, (12, 3)) + [0.1, 0.05, 0.3]:
        data.qpos[:3] = place
        mujoco.mj_forward(model, data)
        ss.call_variable("lab").tick()
        mujoco.mju_mulMatTVec(other, frame, place - data.geom_xpos[zone])
        expected = is_inside(form, np.fromstring(POINTS[form], sep=" "), other)
        found = ss.eval(
            "[within(lab.world.zone, lab.egg), SELECT id FROM lab "
            "WHERE within(lab.world.zone, this) AND this = lab.egg AS list];"
        )
        assert found == [expected, ["egg"] * expected]
        answers.append(expected)
        sides = np.abs(other) <= [0.1, 0.05, 0.02]
        box = "[-0.1, -0.05, -0.02], [0.1, 0.05, 0.02]"
        assert ss.eval(f"inBox(lab.egg, {box}, lab.world.zone);") is bool(sides.all())
    assert 0 < sum(answers) < 12


def is_inside(form, size, place):
    """Whether a place, in the frame of a region, is in it."""
    x, y, z = place
    if form == "box":
        return bool((np.abs(place) < size).all())
    if form == "ellipsoid":
        return bool(((place / size) ** 2).sum() < 1)
    if form == "cylinder":
        return bool(np.hypot(x, y) < size[0] and abs(z) < size[1])
    along = 0.0 if form == "sphere" else np.clip(z, -size[1], size[1])
    return bool(np.linalg.norm([x, y, z - along]) < size[0])


@pytest.mark.slow
def test_raw_sql_says_how_to_ask_for_a_region(moved):
    ss = moved[0]
    pairs = "FROM sites s, entities e WHERE s.name = 'zone' AND e.name = 'ball'"
    with pytest.raises(ssduck.errors.SqlError, match=r"write inBox\(b, \{x: -s.region_x / 2"):
        ss.sql(f"SELECT within(s, e) {pairs}").fetchall()
    low, high = (
        "{" + ", ".join(f"{axis}: {sign}s.region_{axis} / 2" for axis in "xyz") + "}"
        for sign in ("-", "")
    )
    call = f"inBox(e, {low}, {high}, s)"
    found = ss.sql(f"SELECT {call} {pairs}").fetchone()
    assert found == (ss.eval("within(lab.holder.zone, lab.ball);"),)


@pytest.mark.slow
def test_relations_that_hold_of_a_region():
    ss, _, _ = world_of(SITE)
    zone = "lab.holder.zone"
    assert ss.eval(f"collides(lab.ball, {zone});") is True
    assert ss.eval(f"SELECT id FROM lab WHERE collides(this, {zone}) AS list;") == ["ball"]
    pairs = "SELECT id(s.this), id(e.this) FROM s=sites(lab), e=lab WHERE near(s.this, e.this, 0)"
    assert ss.eval(f"{pairs} AS list;") == ["holder.zone", "ball"]
    assert ss.eval(f"contains({zone}, lab.ball);") is True
    assert ss.eval(f"contains({zone}, lab.far);") is False
    # A search for pairs of links does not report regions.
    links = (
        "SELECT id(a.this) FROM a=links(lab), b=links(lab) WHERE collides(a.this, b.this) AS list;"
    )
    assert ss.eval(links) == []


@pytest.mark.slow
def test_recorded_sites_have_the_same_answers(tmp_path):
    ss, model, data = world_of(SITE)
    lab = ss.call_variable("lab")
    program = "SELECT id, position FROM sites(lab) WHERE collides(this, lab.ball);"
    answers = {}
    with ss.record_to(tmp_path / "record", "lab"):
        for _ in range(3):
            mujoco.mj_step(model, data, 60)
            lab.tick()
            answers[lab.time] = ss.eval(program)
    assert set(map(len, answers.values())) == {0, 1}
    replayed = ssduck.open(tmp_path / "record")
    for time, answer in answers.items():
        assert replayed.eval(program.replace("lab)", f"lab{{{time}}})")) == answer
    counts = replayed.sql("SELECT time, count(*) FROM lab.sites_history GROUP BY time").fetchall()
    assert dict.fromkeys(answers, 5).items() <= dict(counts).items()


def test_sites_move_with_the_question(moved):
    ss, model, _ = moved
    ss.add_variable("ajar", ss.call_variable("lab").what_if(joints={"arm": {"hinge": 1.0}}))
    turned = mujoco.MjData(model)
    turned.qpos[:] = moved[2].qpos
    turned.joint("hinge").qpos[0] = 1.0
    mujoco.mj_forward(model, turned)
    assert ss.eval("position(ajar.arm.grip);") == pytest.approx(turned.site("grip").xpos, abs=1e-9)


@pytest.mark.slow
def test_a_region_that_changes_and_a_site_that_moves():
    ss, model, data = world_of(SITE)
    lab = ss.call_variable("lab")
    assert ss.eval("near(lab.far, lab.world.goal, 0.1);") is False
    model.site("goal").pos[:] = 1, 0.1, 0.5
    mujoco.mj_forward(model, data)
    lab.tick()
    assert ss.eval("position(lab.world.goal);") == [1, 0.1, 0.5]
    assert ss.eval("collides(lab.far, lab.world.goal);") is True
    model.site("goal").pos[:] = 1, 0.5, 0.5
    model.site("goal").size[0] = 0.35
    mujoco.mj_forward(model, data)
    lab.tick()
    assert ss.eval("clearance(lab.far, lab.world.goal);") == pytest.approx(0.05)


@pytest.mark.slow
def test_a_world_without_sites_has_none():
    ss, _, _ = world_of("<mujoco><worldbody><body><geom size='.1'/></body></worldbody></mujoco>")
    assert ss.eval("SELECT id FROM sites(lab) AS list;") == []
    assert ss.sql("FROM sites").fetchall() == []
    assert ss.eval("SELECT id FROM lab AS list;") == ["body_1"]
