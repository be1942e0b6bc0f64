"""What is around an entity: enclosed, supports, restsOn, nextTo, by rays and contacts of their own."""

import itertools

import numpy as np
import pybullet
import pytest
from scipy.spatial.transform import Rotation

import ssduck
from ssduck.recording.spec import Recording
from tests.support.cases import sampled
from tests.support.stage import pairs_of
from tests.support.urdf import collision, joint, link, robot

EDGE = 1e-6
WALL = 0.02


def of_boxes(*boxes):
    """A body of boxes, each by its sizes and its centre."""
    return robot(
        link(
            "base",
            mass=0,
            shapes="".join(
                collision(f'<box size="{" ".join(map(str, size))}"/>', xyz=centre)
                for size, centre in boxes
            ),
        )
    )


FLOOR = ((0.4, 0.4, WALL), (0, 0, -0.1))
ROOF = ((0.4, 0.4, WALL), (0, 0, 0.1))
FRONT, BACK = (((WALL, 0.4, 0.2), (x, 0, 0)) for x in (-0.2, 0.2))
LEFT, RIGHT = (((0.4, WALL, 0.2), (0, y, 0)) for y in (-0.2, 0.2))
LEGS = tuple(((WALL, WALL, 0.2), (x, y, 0)) for x in (-0.19, 0.19) for y in (-0.19, 0.19))

# What a body is made of, and whether it encloses what is in its middle.
PROFILES = {
    "cup": ((FLOOR, FRONT, BACK, LEFT, RIGHT), True),
    "tube": ((FRONT, BACK, LEFT, RIGHT), True),
    "shelf": ((FLOOR, ROOF, FRONT, LEFT, RIGHT), True),
    "tunnel": ((FLOOR, ROOF, LEFT, RIGHT), True),
    "room": ((FLOOR, ROOF, FRONT, BACK, LEFT, RIGHT), True),
    "u": ((FLOOR, LEFT, RIGHT), False),
    "l": ((FLOOR, LEFT), False),
    "corner": ((FLOOR, LEFT, FRONT), False),
    "plates": ((FLOOR, ROOF), False),
    "tray": ((FLOOR,), False),
    "table": ((ROOF, *LEGS), False),
}


def torus(radius=0.2, thick=0.05, around=24, across=12):
    """The vertices and faces of a closed ring around z, as an OBJ file."""
    u, v = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    a, b = 2 * np.pi * u / around, 2 * np.pi * v / across
    ring = radius + thick * np.cos(b)
    points = np.stack((ring * np.cos(a), ring * np.sin(a), thick * np.sin(b)), -1).reshape(-1, 3)

    def at(i, j):
        return (i % around) * across + j % across + 1

    faces = [
        face
        for i, j in itertools.product(range(around), range(across))
        for face in ((at(i, j), at(i + 1, j), at(i + 1, j + 1)), (at(i, j), at(i + 1, j + 1), at(i, j + 1)))
    ]  # fmt: skip
    return "".join(f"v {x} {y} {z}\n" for x, y, z in points) + "".join(
        f"f {a} {b} {c}\n" for a, b, c in faces
    )


def of_mesh(file):
    shape = collision(f'<mesh filename="{file}"/>').replace(
        "<collision", '<collision concave="yes"'
    )
    return robot(link("base", mass=0, shapes=shape))


def walled(client, body, centre, turn):
    """How many axes of a body have it on both sides of a point, by PyBullet's rays."""
    axes = Rotation.from_quat(turn).as_matrix().T
    ends = [centre + way * 3 * axis for axis in axes for way in (1, -1)]
    hits = pybullet.rayTestBatch([centre.tolist()] * 6, [end.tolist() for end in ends], physicsClientId=client)  # fmt: skip
    met = [hit[0] == body for hit in hits]
    return sum(one and other for one, other in zip(met[::2], met[1::2], strict=True))


# -- enclosed ------------------------------------------------------------------------------------


@pytest.mark.slow
@sampled("name", [*PROFILES, "ring", "box of triangles"], every=5)
def test_enclosed_is_walls_on_both_sides_along_two_axes(stage, write, name):
    if name in PROFILES:
        text, in_middle = of_boxes(*PROFILES[name][0]), PROFILES[name][1]
    else:
        from tests.support.urdf import box_obj

        file = torus() if name == "ring" else box_obj([-0.2] * 3, [0.2] * 3)
        text, in_middle = of_mesh(write("mesh.obj", file)), True
    body = stage.urdf("a", write("a.urdf", text))
    stage.sphere("b", (3, 0, 0), radius=0.03)
    world = stage.open()
    random = np.random.default_rng(len(name))
    both = list(stage.interpreters(sim=world))
    places = [np.zeros(3), [0.3, 0.3, 0.3], *random.uniform(-0.18, 0.18, (12, 3))]
    found = []
    for number, own in enumerate(places):
        turn = Rotation.identity() if number < 5 else Rotation.random(rng=random)
        origin = random.uniform(-1, 1, 3)
        x, y, z, w = turn.as_quat()
        world["b"].move([9, 9, 9])
        world["a"].move(origin.tolist(), [w, x, y, z])
        centre = turn.apply(own) + origin
        expected = walled(stage.client, body, centre, turn.as_quat()) >= 2
        world["b"].move(centre.tolist())
        for ss in both:
            assert ss.eval("[enclosed(a, b), enclosed(b, a)];") == [expected, False], own
        found.append(expected)
    assert pairs_of(both[0], "enclosed(p, q)") == [("a", "b")] * found[-1]
    assert found[0] is in_middle
    assert False in found
    if in_middle:
        assert found.count(True) > 3


@pytest.mark.slow
@pytest.mark.parametrize("scale", [0.5, 0.9])
def test_of_a_cup_in_a_box_only_one_is_in_the_other(stage, write, scale):
    """The larger one's centre is between the walls of the smaller one, too."""
    small = [tuple(tuple(scale * n for n in part) for part in box) for box in PROFILES["cup"][0]]
    stage.urdf("box", write("box.urdf", of_boxes(*PROFILES["room"][0])))
    stage.urdf("cup", write("cup.urdf", of_boxes(*small)))
    for ss in stage.interpreters(sim=stage.open()):
        assert ss.eval("[enclosed(box, cup), enclosed(cup, box)];") == [True, False]


@pytest.mark.slow
def test_a_convex_shape_around_the_centre_is_no_wall(stage):
    """Blocks in each other are in each other's hull; nothing is within walls."""
    stage.box("block")
    stage.sphere("ball", radius=0.1)
    stage.box("other", (0.2, 0, 0))
    stage.add("ground", pybullet.GEOM_PLANE, (0, 0, 0.3))
    world = stage.open()
    for ss in stage.interpreters(sim=world):
        assert pairs_of(ss, "enclosed(p, q)") == []
        assert ss.eval("contains(block, ball);") is True


# Of a rod along x through the middle of a tube that is 0.42 wide: (half its length, enclosed)
PAST = [(0.05, True), (0.21 + 1e-3 - EDGE, True), (0.21 + 1e-3 + EDGE, False), (2.0, False)]


@pytest.mark.slow
@pytest.mark.parametrize(("half", "holds"), PAST)
def test_what_reaches_past_the_walls_at_both_ends_is_not_in_them(stage, write, half, holds):
    stage.urdf("tube", write("tube.urdf", of_boxes(FRONT, BACK, LEFT, RIGHT)))
    stage.box("rod", half=[half, 0.01, 0.01])
    stage.box("leaning", (0.1, 0, 0), half=[0.25, 0.01, 0.01])  # past one wall only
    for ss in stage.interpreters(sim=stage.open()):
        assert ss.eval("[enclosed(tube, rod), enclosed(tube, leaning)];") == [holds, True]


# The height of a cup's rim is 0.1: (z of the centre of a ball in it, enclosed)
RIM = [(0.1 - EDGE, True), (0.1 + EDGE, False), (0.0, True), (-0.089, True)]


@pytest.mark.parametrize(("z", "holds"), RIM)
def test_the_rim_of_a_cup(stage, write, z, holds):
    stage.urdf("cup", write("cup.urdf", of_boxes(*PROFILES["cup"][0])))
    stage.sphere("ball", (0.05, 0.03, z), radius=0.03)
    for ss in stage.interpreters(sim=stage.open()):
        assert ss.eval("enclosed(cup, ball);") is holds


def drawer(write):
    """A cabinet whose drawer slides out along x, 0.3 m, and whose door turns."""
    case = "".join(
        collision(f'<box size="{" ".join(map(str, size))}"/>', xyz=centre)
        for size, centre in (FLOOR, ROOF, BACK, LEFT, RIGHT)
    )
    tray = [((0.3, 0.3, 0.01), (0, 0, -0.05))]
    tray += [((0.01, 0.3, 0.1), (x, 0, 0)) for x in (-0.15, 0.15)]
    tray += [((0.3, 0.01, 0.1), (0, y, 0)) for y in (-0.15, 0.15)]
    shapes = "".join(
        collision(f'<box size="{" ".join(map(str, size))}"/>', xyz=centre) for size, centre in tray
    )
    limit = '<limit lower="{}" upper="{}" effort="1" velocity="1"/>'
    return robot(
        link("case", shapes=case),
        link("tray", shapes=shapes),
        link("leaf", shapes=collision('<box size="0.01 0.1 0.1"/>', xyz=(0, 0.5, 0))),
        link("knob"),
        joint("slide", "prismatic", "case", "tray", axis=(-1, 0, 0), limit=limit.format(0, 0.3)),
        joint("hinge", "revolute", "case", "leaf", limit=limit.format(-1.5, 0)),
        joint("turn", "continuous", "case", "knob"),
    )


@pytest.mark.slow
def test_a_drawer_is_of_its_cabinet(stage, write):
    stage.urdf("cabinet", write("cabinet.urdf", drawer(write)))
    stage.sphere("ball", radius=0.02)
    world = stage.open()
    for ss in stage.interpreters(sim=world):
        for out, there in itertools.product((0.0, 0.15, 0.3), (0.05, 0.25)):
            world["cabinet"].move([0, 0, 0], joints={"slide": out})
            world["ball"].move([-there, 0, 0])
            # Behind the drawer that is out, the ball is in the case.
            expected = there <= out + 0.15
            assert ss.eval("enclosed(cabinet, ball);") is expected, (out, there)


# -- supports and restsOn ------------------------------------------------------------------------


def bridge(stage, mass=1.0):
    """A plank on two blocks, a cup on the plank, a ball on a ground beside a post that it touches."""
    stage.add("ground", pybullet.GEOM_PLANE)
    for name, x in (("block_1", -0.4), ("block_2", 0.4)):
        stage.box(name, (x, 0, 0.1), half=[0.1, 0.1, 0.1])
    stage.box("plank", (0, 0, 0.22), half=[0.5, 0.1, 0.02], mass=mass)
    stage.add("cup", pybullet.GEOM_CYLINDER, (0.1, 0, 0.29), mass=mass, radius=0.04, height=0.1)
    stage.box("lid", (0.1, 0, 0.345), half=[0.05, 0.05, 0.005], mass=mass)
    stage.box("post", (2, 0, 0.5), half=[0.1, 0.1, 0.5])
    stage.box("book", (2.2, 0, 0.1), half=[0.1, 0.1, 0.1], mass=mass)
    pybullet.setGravity(0, 0, -9.81, physicsClientId=stage.client)
    return stage.open()


SUPPORTS = {
    ("block_1", "plank"), ("block_2", "plank"), ("plank", "cup"), ("cup", "lid"),
    ("ground", "block_1"), ("ground", "block_2"), ("ground", "post"), ("ground", "book"),
}  # fmt: skip
ON = SUPPORTS - {("block_1", "plank"), ("block_2", "plank")}
RESTS = ON | {("plank", "lid")}
BESIDE = {("post", "book"), ("book", "post")}
MEANT = {"supports": SUPPORTS, "on": ON, "restsOn": RESTS, "nextTo": BESIDE, "enclosed": set()}


def told(ss, relation, source):
    """The pairs of names of which a relation holds, in SelectScript."""
    program = "SELECT id(p.this), id(q.this) FROM p={0}, q={0} WHERE {1}(p.this, q.this) AS list;"
    flat = ss.eval(program.format(source, relation))
    return set(zip(flat[::2], flat[1::2], strict=True))


@pytest.mark.slow
@sampled("relation", MEANT, every=5)
def test_the_same_by_every_door(stage, relation, tmp_path):
    """Live and settled, row by row, in raw SQL, what if, at a past tick, and in a record."""
    world = bridge(stage)
    ss, slow = stage.interpreters(sim=world)
    for one in (ss, slow):
        one.record("sim", Recording())
    world.step(60)
    wanted = MEANT[relation]
    for one in (ss, slow):
        assert told(one, relation, "sim") == wanted
        assert set(pairs_of(one, f'"{relation}"(p, q)')) == wanted
    at = world.time
    world.step(1)
    world["plank"].move([5, 5, 1])
    one_less = told(ss, relation, "sim")
    assert one_less != wanted or relation in ("nextTo", "enclosed")
    for one in (ss, slow):
        assert told(one, relation, f"sim{{{at}}}") == wanted
    lifted = world.what_if({"cup": [1, 0, 0, 0, 0.1, 0, 3], "lid": [1, 0, 0, 0, 0.1, 0, 4]})
    ss.add_variable("what", lifted)
    assert told(ss, relation, "what") == {p for p in one_less if not {"cup", "lid"} & set(p)}
    ss.export(tmp_path / "run")
    with ssduck.open(tmp_path / "run") as opened:
        assert told(opened, relation, f"sim{{{at}}}") == wanted
        assert told(opened, relation, "sim") == one_less
        if relation != "enclosed":
            a, b = min(wanted - one_less or wanted)
            opened.eval(f"a = SELECT obj FROM sim WHERE id(this) == '{a}' AS value;")
            opened.eval(f"b = SELECT obj FROM sim WHERE id(this) == '{b}' AS value;")
            assert opened.eval(f"count(holds({relation}(a, b)));") >= 1


# Of a block's top at 0 and a plank that is 0.04 thick: (its middle, whether it is carried)
CARRIED = [
    ((0, 0, 0.02), True),
    ((0.55, 0, 0.02), True),  # its middle is beyond the edge
    ((0, 0, 0.021 - EDGE), True),
    ((0, 0, 0.021 + EDGE), False),
    ((0.6 - EDGE, 0, 0.02), True),
    ((0.7, 0, 0.02), False),
    ((0.6005, 0, -0.1), False),  # beside it
    ((0, 0, -0.22), False),  # under it
]


@pytest.mark.slow
@sampled(("place", "holds"), CARRIED, every=3)
def test_supports_at_its_edges(stage, place, holds):
    stage.box("block", (0, 0, -0.1), half=[0.5, 0.5, 0.1])
    stage.box("plank", place, half=[0.1, 0.1, 0.02])
    for ss in stage.interpreters(sim=stage.open()):
        assert ss.eval("supports(block, plank);") is holds
        is_below = place[2] < -0.15
        assert ss.eval("supports(plank, block);") is is_below


@pytest.mark.slow
@sampled(("degrees", "holds"), [(0, True), (29.9, True), (30.1, False), (60, False)], every=4)
def test_supports_on_a_slope(stage, degrees, holds):
    turn = Rotation.from_euler("y", degrees, degrees=True)
    stage.box("slope", half=[0.5, 0.5, 0.1], turn=turn.as_quat())
    stage.sphere("ball", turn.apply([0, 0, 0.2]), radius=0.1)
    for ss in stage.interpreters(sim=stage.open()):
        assert ss.eval("supports(slope, ball);") is holds


# A ball of 0.1 m in a corner of plates: (each plate's tilt and place), what carries it
CORNERS = {
    "a groove": ({"p": (45, "y"), "q": (-45, "y")}, {"p", "q"}),
    "a steep groove": ({"p": (79, "y"), "q": (-79, "y")}, {"p", "q"}),
    "a steeper one": ({"p": (81, "y"), "q": (-81, "y")}, set()),
    "a slope": ({"p": (45, "y")}, set()),
    "a slope and a wall": ({"p": (45, "y"), "q": (-90, "y")}, {"p"}),
    "a slope and a floor": ({"p": (45, "y"), "q": (0, "y")}, {"q"}),
    "a slope, a wall and a floor": ({"p": (45, "y"), "q": (-90, "y"), "r": (0, "y")}, {"p", "r"}),
    "two slopes at a right angle": ({"p": (45, "y"), "q": (45, "x")}, set()),
    "three slopes": ({"p": (40, "y"), "q": (-40, "yz", 60), "r": (-40, "yz", -60)}, {"p", "q", "r"}),
}  # fmt: skip


@pytest.mark.slow
@sampled("name", CORNERS, every=4)
def test_what_carries_together(stage, name):
    plates, carriers = CORNERS[name]
    for plate, (degrees, about, *more) in plates.items():
        turn = Rotation.from_euler(about, [degrees, *more][: len(about)], degrees=True)
        up = turn.apply([0, 0, 1])
        stage.box(plate, -0.2 * up, half=[0.3, 0.3, 0.1], turn=turn.as_quat())
    stage.sphere("ball", radius=0.1)
    ss, slow = stage.interpreters(sim=stage.open())
    for one in (ss, slow):
        found = one.eval("SELECT id FROM sim WHERE supports(this, ball) AS list;")
        assert set(found) == carriers


@pytest.mark.slow
def test_a_ball_on_three_balls(stage):
    """Settled by the physics: the pushes are 35 degrees off up, and each one is needed."""
    for number in range(3):
        angle = 2 * np.pi * number / 3
        place = 0.2 / np.sqrt(3) * np.array([np.cos(angle), np.sin(angle), 0])
        stage.sphere(f"ball_{number}", place, radius=0.1)
    stage.sphere("top", (0, 0, 0.2 * np.sqrt(2 / 3) + 0.001), radius=0.1, mass=1.0)
    pybullet.setGravity(0, 0, -9.81, physicsClientId=stage.client)
    world = stage.open()
    world.step(120)
    ss, _ = stage.interpreters(sim=world)
    assert pairs_of(ss, "supports(p, q)") == [(f"ball_{number}", "top") for number in range(3)]
    assert pairs_of(ss, "inContact(p, q) AND q.name = 'top'") == pairs_of(ss, "supports(p, q)")


@pytest.mark.slow
def test_what_rests_in_a_circle_ends(stage):
    """As of two hooks, each of whose ends lies on the other's foot."""
    stage.box("a", half=[0.5, 0.5, 0.1])
    stage.box("b", (0, 0, 0.2), half=[0.5, 0.5, 0.1])
    world = stage.open()
    ss, _ = stage.interpreters(sim=world)
    assert ss.eval("[restsOn(a, b), restsOn(b, a)];") == [True, False]
    around = world.snapshot.shapes()._neighbours
    around._resting.clear()
    a, b = (world.snapshot.shapes()._numbers[world[name].id] for name in "ab")
    around.__dict__["_on"] = {a: frozenset({b}), b: frozenset({a})}
    assert ss.eval("[restsOn(a, b), restsOn(b, a), restsOn(a, a)];") == [True, True, False]


# -- nextTo --------------------------------------------------------------------------------------

UNIT = (0.1, 0.1, 0.1)  # half sides; the bound of two is 0.2 / 3
FAR = 0.2 / 3
# (name, half sides, place) of three; whether a and b are beside each other
SCENES = {
    "at the bound": ([("a", UNIT, (0, 0, 0)), ("b", UNIT, (0.2 + FAR - EDGE, 0, 0))], True),
    "beyond it": ([("a", UNIT, (0, 0, 0)), ("b", UNIT, (0.2 + FAR + EDGE, 0, 0))], False),
    "touching": ([("a", UNIT, (0, 0, 0)), ("b", UNIT, (0.2, 0, 0))], True),
    "corner to corner": ([("a", UNIT, (0, 0, 0)), ("b", UNIT, (0.24, 0.24, 0))], True),
    "heights just overlap": ([("a", UNIT, (0, 0, 0)), ("b", UNIT, (0.22, 0, 0.2 - EDGE))], True),
    "heights do not": ([("a", UNIT, (0, 0, 0)), ("b", UNIT, (0.22, 0, 0.2 + EDGE))], False),
    "one above the other": ([("a", UNIT, (0, 0, 0)), ("b", UNIT, (0, 0, 0.2))], False),
    "a wall between": (
        [("a", UNIT, (0, 0, 0)), ("b", UNIT, (0.25, 0, 0)), ("c", (0.01, 0.3, 0.3), (0.125, 0, 0))],
        False,
    ),
    "a mat between": (
        [("a", UNIT, (0, 0, 0)), ("b", UNIT, (0.25, 0, 0)), ("c", (0.01, 0.3, 0.02), (0.125, 0, -0.08))],
        True,
    ),
    "a post between": (
        [("a", UNIT, (0, 0, 0)), ("b", UNIT, (0.25, 0, 0)), ("c", (0.01, 0.02, 0.3), (0.125, 0, 0))],
        True,
    ),
    "a wall behind": (
        [("a", UNIT, (0, 0, 0)), ("b", UNIT, (0.25, 0, 0)), ("c", (0.01, 0.3, 0.3), (0.37, 0, 0))],
        True,
    ),
    "a long one's end": (
        [("a", (0.02, 2.0, 0.5), (0, 0, 0)), ("b", UNIT, (0.15, 1.8, -0.4)), ("c", UNIT, (0.15, 1.5, -0.4))],
        True,
    ),
    "a tall one": ([("a", (0.1, 0.1, 1.0), (0, 0, 1)), ("b", UNIT, (0.25, 0, 0.1))], True),
}  # fmt: skip


TURNED = [name for name in SCENES if "bound" not in name and "beyond" not in name]


@pytest.mark.slow
@sampled(
    ("name", "degrees"),
    [*((name, 0) for name in SCENES), *((name, 37) for name in TURNED)],
    every=8,
)
def test_next_to_is_beside_with_nothing_between(stage, name, degrees):
    boxes, holds = SCENES[name]
    turn = Rotation.from_euler("z", degrees, degrees=True)
    for body, half, place in boxes:
        stage.box(body, turn.apply(place), half=list(half), turn=turn.as_quat())
    for ss in stage.interpreters(sim=stage.open()):
        assert ss.eval("[nextTo(a, b), nextTo(b, a)];") == [holds, holds]


@pytest.mark.slow
def test_what_is_on_or_in_something_is_not_beside_it(stage, write):
    rim = [((0.02, 0.4, 0.06), (x, 0, -0.07)) for x in (-0.2, 0.2)]
    stage.urdf("tray", write("tray.urdf", of_boxes(FLOOR, *rim)))
    stage.add("plate", pybullet.GEOM_CYLINDER, (0.05, 0, -0.085), radius=0.1, height=0.01)
    stage.add("cup", pybullet.GEOM_CYLINDER, (0.1, 0, -0.03), radius=0.03, height=0.1)
    stage.add("mug", pybullet.GEOM_CYLINDER, (0.1, 0.07, -0.03), radius=0.03, height=0.1)
    stage.urdf("box", write("box.urdf", of_boxes(*PROFILES["cup"][0])), (2, 0, 0))
    stage.sphere("ball", (2.1, 0, -0.04), radius=0.05)
    stage.sphere("marble", (2.03, 0.03, -0.07), radius=0.02)
    for ss in stage.interpreters(sim=stage.open()):
        beside = {frozenset(pair) for pair in pairs_of(ss, "nextTo(p, q)")}
        assert beside == {frozenset(("cup", "mug")), frozenset(("ball", "marble"))}
        assert ss.eval("[on(tray, plate), restsOn(tray, cup), enclosed(box, ball)];") == [True] * 3


@pytest.mark.slow
def test_next_to_is_symmetric_and_near(stage):
    """Of boxes at random: both ways alike, and never of what the definition leaves out."""
    random = np.random.default_rng(3)
    for number in range(28):
        turn = Rotation.random(rng=random).as_quat()
        half = random.uniform(0.03, 0.15, 3).tolist()
        stage.box(f"b{number}", random.uniform(0, 0.9, 3).tolist(), half=half, turn=turn)
    world = stage.open()
    ss, slow = stage.interpreters(sim=world)
    found = set(pairs_of(ss, "nextTo(p, q)"))
    assert found == {(q, p) for p, q in found}
    assert len(found) > 20
    assert set(told(slow, "nextTo", "sim")) == found
    near = pairs_of(ss, "p.id <> q.id AND p.zmin <= q.zmax AND q.zmin <= p.zmax AND clearance(p, q) "
                    "<= (p.xmax - p.xmin + p.ymax - p.ymin + p.zmax - p.zmin "
                    "+ q.xmax - q.xmin + q.ymax - q.ymin + q.zmax - q.zmin) / 18")  # fmt: skip
    assert found < set(near)
    for held in ("supports", "contains", "enclosed", "restsOn"):
        assert not found & set(pairs_of(ss, f"{held}(p, q)"))


@pytest.mark.slow
def test_what_has_no_shapes_is_nowhere(stage, write):
    stage.urdf("none", write("none.urdf", robot(link("base"))))
    stage.urdf("box", write("box.urdf", of_boxes(*PROFILES["room"][0])))
    for ss in stage.interpreters(sim=stage.open()):
        for relation in MEANT:
            assert pairs_of(ss, f'"{relation}"(p, q)') == []
            assert ss.eval(f"[{relation}(box, none), {relation}(none, box)];") == [False, False]
