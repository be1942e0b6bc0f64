"""What rests on something in real PyBullet is on it, whatever margins the solver keeps."""

import itertools

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import SelectScriptError
from tests.support.bodies import solid
from tests.support.cases import sampled
from tests.support.urdf import box_obj, collision, link, robot

pytestmark = pytest.mark.slow

CUBE = [[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
FACES = [0, 1, 3, 0, 3, 2, 4, 7, 5, 4, 6, 7, 0, 5, 1, 0, 4, 5]
FACES += [2, 3, 7, 2, 7, 6, 0, 2, 6, 0, 6, 4, 1, 5, 7, 1, 7, 3]
# Of each kind how it is made at a size, and half its height there.
MADE = {
    "box": (lambda s: {"kind": pybullet.GEOM_BOX, "halfExtents": [s / 2] * 3}, 0.5),
    "sphere": (lambda s: {"kind": pybullet.GEOM_SPHERE, "radius": s / 2}, 0.5),
    "cylinder": (
        lambda s: {"kind": pybullet.GEOM_CYLINDER, "radius": s / 2, "height": s},
        0.5,
    ),
    "capsule": (
        lambda s: {"kind": pybullet.GEOM_CAPSULE, "radius": s / 2, "height": s / 2},
        0.75,
    ),
    "hull": (
        lambda s: {"kind": pybullet.GEOM_MESH, "vertices": CUBE, "meshScale": [s] * 3},
        0.5,
    ),
    "hull off its centre": (
        lambda s: {
            "kind": pybullet.GEOM_MESH,
            "vertices": (np.array(CUBE) * s).tolist(),
            "collisionFramePosition": [0, 0, s / 4],
        },
        0.25,
    ),
}
# What models are made of; True for concave meshes, which cannot fall.
FILES = {
    "file hull": ('<mesh filename="cube.obj" scale="{s} {s} {s}"/>', 0.5, False),
    "file cylinder": ('<cylinder radius="{r}" length="{s}"/>', 0.5, False),
    "compound": ('<mesh filename="cube.obj" scale="{s} {s} {s}"/>', 0.5, False),
    "file mesh": ('<mesh filename="cube.obj" scale="{s} {s} {s}"/>', 0.5, True),
    "made mesh": ("", 0.5, True),
    "made mesh off its centre": ("", 0.25, True),
    "made file mesh": ("", 0.5, True),
    "height field": ("", 0.0, True),
    "plane": ("", 0.0, True),
}
CONCAVE = {"flags": pybullet.GEOM_FORCE_CONCAVE_TRIMESH}
FIELD = {"rows": 5, "columns": 6}
UNDER = [*MADE, *FILES]
OVER = [kind for kind in UNDER if kind in MADE or not FILES[kind][2]]


class Yard:
    """Pairs of bodies, one on the other, each pair in a place of its own."""

    def __init__(self, client, write):
        self.client, self.write = client, write
        self.names, self.shapes, self.count = {}, {}, 0
        pybullet.setGravity(0, 0, -10, client)
        self.cube = str(write("cube.obj", box_obj((-0.5,) * 3, (0.5,) * 3)))

    def add(self, name, kind, size, place, *, mass=0.0, margin=None):
        """A body of a kind at a place; its centre."""
        if kind in FILES and FILES[kind][0]:
            body = self._load(kind, size, place, mass)
        else:
            body = solid(self.client, mass=mass, place=place, **self._made(kind, size))
        if margin is not None:
            pybullet.changeDynamics(body, -1, collisionMargin=margin, physicsClientId=self.client)
        if kind == "height field":
            self.shapes[body, -1] = ssduck.height_field(
                [0.0] * 30, **FIELD, scale=[size / 4, size / 5, 1]
            )
        self.names[body] = name
        return body

    def _made(self, kind, size):
        if kind == "plane":
            return {"kind": pybullet.GEOM_PLANE}
        if kind == "height field":
            return {
                "kind": pybullet.GEOM_HEIGHTFIELD,
                "meshScale": [size / 4, size / 5, 1],
                "heightfieldData": [0.0] * 30,
                "numHeightfieldRows": FIELD["rows"],
                "numHeightfieldColumns": FIELD["columns"],
            }
        if kind == "made file mesh":
            own = {"fileName": self.cube, "meshScale": [size] * 3}
            return {"kind": pybullet.GEOM_MESH} | own | CONCAVE
        if kind.startswith("made mesh"):
            hull = kind.replace("made mesh", "hull")
            return MADE[hull][0](size) | {"indices": FACES} | CONCAVE
        return MADE[kind][0](size)

    def _load(self, kind, size, place, mass):
        text, _, concave = FILES[kind]
        one = text.format(s=size, r=size / 2)
        parts = collision(one)
        if kind == "compound":
            parts += collision(one, xyz=(0, 0, size / 8))
        if concave:
            parts = parts.replace("<collision>", '<collision concave="yes">')
        self.count += 1
        path = self.write(f"{self.count}.urdf", robot(link("base", mass=mass, shapes=parts)))
        return pybullet.loadURDF(
            str(path), place, useFixedBase=not mass, physicsClientId=self.client
        )

    def stack(self, under, over, place, **more):
        """Something over something, 2 mm above where it rests; the names."""
        names = (f"{under}, {over}", f"{over} on {under}")
        x, y = place
        half = FILES[under][1] if under in FILES else MADE[under][1]
        self.add(names[0], under, 2.0, [x, y, 0], **more)
        top = 2.0 * (1 - half if "off" in under else half)
        if under == "compound":
            top += 0.25
        bottom = FILES[over][1] if over in FILES else MADE[over][1]
        self.add(names[1], over, 0.4, [x, y, top + 0.4 * bottom + 0.004], mass=1.0)
        return names

    def world(self):
        return ssduck.World.attach(self.client, names=self.names, shapes=self.shapes)


@pytest.fixture
def yard(client, write):
    return Yard(client, write)


def settled(yard, steps=480):
    for _ in range(steps):
        pybullet.stepSimulation(yard.client)
    return yard.world()


def test_every_pair_at_rest(yard):
    """All of it in one world: each pair 10 m from the others, and planes in worlds of their own."""
    pairs = [
        yard.stack(under, over, (10.0 * n, 10.0 * m))
        for (n, under), (m, over) in itertools.product(
            enumerate(kind for kind in UNDER if kind != "plane"), enumerate(OVER)
        )
    ]
    check(settled(yard), pairs)


def test_everything_on_a_plane(yard):
    yard.add("ground", "plane", 1.0, [0, 0, 0])
    for n, kind in enumerate(OVER):
        half = FILES[kind][1] if kind in FILES else MADE[kind][1]
        yard.add(kind, kind, 0.4, [3.0 * n, 0, 0.4 * half + 0.004], mass=1.0)
    check(settled(yard), [("ground", kind) for kind in OVER])


def check(world, pairs):
    """All forms of all doors say that the pairs touch, and that no others do."""
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", world)
        asked = "SELECT a.name, b.name, inContact(a, b), "
        asked += '"on"(a, b), touching(a, b), touching(b, a), near(a, b, 0.001)'
        asked += ", clearance(a, b), collides(a, b, 1e-3), collides(a, b, 0.02) "
        asked += "FROM entities a, entities b WHERE "
        told = {row[:2]: row[2:] for row in ss.sql(asked + "near(a, b, 0.01)").fetchall()}
        for pair in pairs:
            contact, *rests, _, clearance, deep, deeper = told[pair]
            assert contact, pair
            assert rests == [True] * 3, (pair, clearance)
            assert not deep, pair
            assert not deeper, pair
        for call in ("on", "touching"):
            program = (
                f"SELECT [id(a.this), id(b.this)] FROM a=sim, b=sim "
                f"WHERE {call}(a.this, b.this) AS list;"
            )
            found = set(map(tuple, ss.eval(program)))
            assert set(pairs) <= found
            assert {frozenset(pair) for pair in found} == set(map(frozenset, pairs))


# What `changeDynamics` sets, what it comes to, and what rests there without being near.
CHANGED = [
    ("hull", 0.01, 0.01),
    ("hull", 0.0, 0.0),
    ("hull off its centre", 0.01, 0.01),
    ("file hull", 0.01, 0.01),
    ("file cylinder", 0.01, 0.01),
    ("compound", 0.01, 0.001),  # it does not get through to hulls of files in a compound
    ("file mesh", 0.01, 0.01),
    ("made mesh", 0.01, 0.01),
    ("made mesh off its centre", 0.01, 0.01),
    ("made file mesh", 0.01, 0.01),
    ("height field", 0.01, 0.01),
    ("made mesh", 0.0, 0.0),
    ("height field", 0.0, 0.0),
    ("box", 0.01, 0.0),
    ("sphere", 0.01, 0.0),
    ("cylinder", 0.01, 0.0),
    ("capsule", 0.01, 0.0),
]


def test_margins_that_are_set(yard):
    for n, (kind, given, _) in enumerate(CHANGED):
        yard.stack(kind, "box", (10.0 * n, 0), margin=given)
        yard.names |= {len(yard.names) - 2: f"under_{n}", len(yard.names) - 1: f"over_{n}"}
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", settled(yard))
        told = "SELECT max(margin) FROM shapes JOIN entities e ON e.id = entity WHERE e.name = '{}'"
        for n, (kind, _, margin) in enumerate(CHANGED):
            assert ss.sql(told.format(f"under_{n}")).fetchall() == [(margin,)], kind
            both = f"sim.under_{n}, sim.over_{n}"
            found = ss.eval(f"[on({both}), touching({both}, 1e-4), inContact({both})];")
            assert found == [True] * 3, kind
            apart = ss.eval(f"clearance({both});")
            # The many triangles of a field push unevenly.
            off = 2e-4 if kind == "height field" else 1e-4
            assert apart == pytest.approx(margin, abs=off), kind


# Two hulls side by side in x, each with a margin of 1 mm.
SIDE_BY_SIDE = [
    ("touching(a, b)", 0.003 - 2e-6, True),
    ("touching(a, b)", 0.003 + 2e-6, False),
    ("touching(a, b, 0)", 0.002 - 2e-6, True),
    ("touching(a, b, 0)", 0.002 + 2e-6, False),
    ("touching(a, b, -0.001)", 0.001 - 2e-6, True),
    ("touching(a, b, -0.001)", 0.001 + 2e-6, False),
    ("touching(a, b, -0.002)", 0.01, False),
    ("touching(a, c)", 0.002 - 2e-6, True),  # c is a box behind b
    ("touching(a, c)", 0.002 + 2e-6, False),
    ("near(a, b, 0.001)", 0.001 - 2e-6, True),
    ("near(a, b, 0.001)", 0.001 + 2e-6, False),
    ("collides(a, b)", -0.9e-6 + 2e-7, False),
    ("collides(a, b, 1e-3)", -1e-3 + 2e-6, False),
    ("collides(a, b, 1e-3)", -1e-3 - 2e-6, True),
    ("collides(a, c, 1e-3)", -1e-3 + 2e-6, False),
    ("collides(a, c, 1e-3)", -1e-3 - 2e-6, True),
    ("collides(a, b, 0)", -2e-6, True),
    ("collides(a, b, 0)", 2e-6, False),
]


@pytest.fixture
def hulls(yard):
    for name, kind, place in (("a", "hull", 0.0), ("b", "hull", 5.0), ("c", "box", -5.0)):
        yard.add(name, kind, 1.0, [place, 0, 0])
    return yard.world()


def doors(ss, condition, *, raw):
    """What each door says of a condition on two of three bodies."""
    first, second = condition[condition.index("(") + 1], condition[condition.index(",") + 2]
    of_rows = condition.replace(f"({first},", "(p,").replace(f" {second}", " q")
    yield ss.eval(f"{condition};")
    named = f"id(p.this) == '{first}' AND id(q.this) == '{second}'"
    rows = of_rows.replace("(p,", "(p.this,").replace(" q", " q.this")
    for text in (f"{named} AND {rows}", f"{rows} AND {named}", f"{named} AND NOT (NOT {rows})"):
        yield ss.eval(f"SELECT id(p.this) FROM p=sim, q=sim WHERE {text} AS list;") == [first]
    if not raw:
        return
    names = f"p.name = '{first}' AND q.name = '{second}'"
    yield ss.sql(f"SELECT {of_rows} FROM entities p, entities q WHERE {names}").fetchall()[0][0]
    joined = f"SELECT p.name FROM entities p JOIN entities q ON {of_rows} WHERE {names}"
    yield ss.sql(joined).fetchall() == [(first,)]


@sampled("slow", [False, True], every=2)
def test_at_the_bounds_of_margins_and_depths(hulls, slow):
    with ssduck.Interpreter(row_by_row=slow) as ss:
        for gap in sorted({gap for _, gap, _ in SIDE_BY_SIDE}):
            beside = {"b": [1, 0, 0, 0, 1 + gap, 0, 0], "c": [1, 0, 0, 0, -1 - gap, 0, 0]}
            ss.add_variable("sim", hulls.what_if(beside))
            for name in "abc":
                ss.add_variable(name, ss.call_variable("sim")[name])
            for condition, at, expected in SIDE_BY_SIDE:
                if at == gap:
                    found = list(doors(ss, condition, raw=not slow))
                    assert found == [expected] * len(found), (condition, gap)


@sampled("slow", [False, True], every=2)
def test_a_depth_below_0_is_an_error(hulls, slow):
    """Also where no boxes meet, so that no shapes are compared."""
    with ssduck.Interpreter(row_by_row=slow) as ss:
        ss.add_variable("sim", hulls)
        for depth in ("-1", "-1e-9", "0 - 0.001"):
            for text in (
                f"collides(sim.a, sim.b, {depth});",
                f"SELECT id FROM sim WHERE collides(sim.a, this, {depth}) AS list;",
                f"SELECT id(p.this) FROM p=sim, q=sim "
                f"WHERE collides(p.this, q.this, {depth}) AS list;",
            ):
                with pytest.raises(SelectScriptError, match="metres from 0 up"):
                    ss.eval(text)
        for depth in ("-1", "-1e-9", "0 - 0.001", "'nan'::DOUBLE", "p.z - 1"):
            for text in (
                f"SELECT collides(p, q, {depth}) FROM entities p, entities q",
                f"SELECT 1 FROM entities p JOIN entities q ON collides(p, q, {depth})",
                f"SELECT 1 FROM entities p, entities q WHERE NOT collides(p, q, {depth})",
                f"FROM colliding_pairs({depth})",
            ):
                if "p.z" in depth and "colliding_pairs" in text:
                    continue
                with pytest.raises(SelectScriptError, match="metres from 0 up"):
                    ss.sql(text).fetchall()
        nothing = "SELECT 1 FROM entities p JOIN entities q ON collides(p, q, NULL)"
        assert ss.sql(nothing).fetchall() == []


def test_tables_of_all_pairs_take_a_depth(hulls):
    overlapping = {"b": [1, 0, 0, 0, 0.99, 0, 0], "c": [1, 0, 0, 0, -0.9, 0, 0]}
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", hulls.what_if(overlapping))
        count = "SELECT count(*) FROM colliding_pairs({})"
        for given, found in (("", 4), ("0.005", 4), ("depth := 0.05", 2), ("0.2", 0)):
            assert ss.sql(count.format(given)).fetchall() == [(found,)]


RECORDED = [
    "holds(on(under, over))",
    "holds(touching(under, over))",
    "holds(touching(over, under, 0.0005))",
    "holds(collides(over, under, 0.001))",
    "holds(inContact(under, over))",
    "SELECT tick(this) FROM sim{} WHERE on(under, this) AS list",
]


@sampled("place", ["run", "run.duckdb"], every=2)
def test_margins_are_recorded(yard, tmp_path, place):
    yard.add("under", "hull", 1.0, [0, 0, 0])
    yard.add("over", "hull", 0.4, [0, 0, 0.75], mass=1.0)
    world = yard.world()
    tables = ("entities", "shapes", "contacts")
    path = tmp_path / place
    file = str(path) if path.suffix else ":memory:"
    recording = ssduck.Recording(tables=tables)
    with ssduck.Interpreter(file, recording=recording) as ss:
        ss.add_variable("sim", world)
        for _ in range(60):
            world.step(8)
        live = answers(ss, world)
        if not path.suffix:
            ss.export(path)
    with ssduck.open(path) as opened:
        assert answers(opened, opened.call_variable("sim")) == live
        told = opened.sql("SELECT DISTINCT margin FROM shapes_history").fetchall()
        assert told == opened.sql("SELECT DISTINCT margin FROM shapes").fetchall() == [(0.001,)]
        assert opened.sql("SELECT DISTINCT margin FROM shapes_model").fetchall() == [(0.001,)]


def answers(ss, world):
    for name in ("under", "over"):
        ss.add_variable(name, world[name])
    found = [ss.eval(f"{text};") for text in RECORDED]
    assert [bool(one) for one in found] == [True, True, True, False, True, True]
    return found
