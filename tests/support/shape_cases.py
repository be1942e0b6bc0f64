"""Shapes for the tests of their relations."""

import numpy as np
import pytest

from ssduck.sql.relations.registry import RELATIONS
from tests.support.stage import BOX, SPHERE

pybullet = pytest.importorskip("pybullet")

CYLINDER, CAPSULE = pybullet.GEOM_CYLINDER, pybullet.GEOM_CAPSULE

EDGE = 2e-9

# The relations that hold of two entities or not.
HOLDS = {
    name
    for name, relation in RELATIONS.items()
    if relation.result == "boolean"
    and [p.type for p in relation.parameters[: relation.required_count]] == ["entity"] * 2
}


def approx(value):
    return pytest.approx(np.array(value), abs=1e-9)


SHAPES = [(BOX, {"halfExtents": [0.3, 0.2, 0.4]}), (SPHERE, {"radius": 0.3}),
          (CYLINDER, {"radius": 0.2, "height": 0.7}), (CAPSULE, {"radius": 0.2, "height": 0.5})]  # fmt: skip

# The viewer at the origin looks along +x: (position of b, relative to a, what it is)
SIDES = [
    ((1, 0.5, 0), "behind"),
    ((1, 1, 0), "behind"),
    ((1, -1, 9), "behind"),
    ((-1, 0.5, 0), "inFrontOf"),
    ((-1, -1, 0), "inFrontOf"),
    ((0.5, 1, 0), "leftOf"),
    ((1, 1 + EDGE, 0), "leftOf"),
    ((0.5, -1, 0), "rightOf"),
    ((-1, -1 - EDGE, 0), "rightOf"),
    ((0, 0, 1), None),
]

TURNED = [
    (degrees, offset, side)
    for degrees in (0, 90, -30)
    for offset, side in SIDES
    # Turned, what is a tie or nearly one is rounded to either side.
    if not degrees or side is None or abs(abs(offset[0]) - abs(offset[1])) > 1e-6
]

FORMS = [
    ("SELECT id FROM sim WHERE collides(b0, this) AS list;", ["b1"]),
    ("SELECT id FROM sim WHERE collides(this, b0) AS list;", ["b1"]),
    ("SELECT to(id(p.this), 'p'), to(id(q.this), 'q') FROM p=sim, q=sim WHERE collides(p.this, q.this) AS list;",
     ["b0", "b1", "b1", "b0"]),
    ("SELECT id FROM sim WHERE NOT touching(floor, this) AS list;", ["floor"]),
    ("SELECT id FROM sim WHERE NOT touching(b1, this) AS list;", ["b1", "b3"]),
    ("SELECT id FROM sim WHERE collides(b0, this) OR id(this) == 'b3' AS list;", ["b1", "b3"]),
    ("SELECT id FROM sim WHERE collides(b0, this) XOR touching(b1, this) AS list;", ["floor", "b0", "b1", "b2"]),
    ("SELECT IF(on(floor, this); id(this); '-') FROM sim AS list;", ["-", "b0", "b1", "b2", "b3"]),
    ("SELECT id FROM p=sim WHERE count(SELECT q.this FROM q=sim WHERE collides(p.this, q.this) AS list) > 0 AS list;",
     ["b0", "b1"]),
    ("SELECT id FROM p=sim WHERE [] == (SELECT q.this FROM q=sim WHERE near(p.this, q.this, 0.5) AND NOT id(q.this) == 'floor' AS list) AS list;",
     ["b3"]),
    ("SELECT id FROM sim WHERE near(b2, this, 2.0) AND NOT touching(b2, this) AS list;", ["b0"]),
    ("SELECT id FROM sim WHERE collides(this, b0) == True AS list;", ["b1"]),
    ("SELECT id FROM sim ORDER BY clearance(b3, this), id LIMIT 3 AS list;", ["b3", "floor", "b2"]),
    *(
        (f"SELECT [id(p.this), id(q.this)] FROM p=sim, q=sim WHERE {condition} ORDER BY id(p.this), id(q.this) AS list;", expected)
        for condition, expected in (
            ("near(p.this, q.this, 1.0) AND id(p.this) < id(q.this) AND NOT 'floor' IN [id(p.this), id(q.this)]", None),
            ("near(p.this, q.this, half + 0.5)", None),
            ("near(p.this, q.this, -1)", []),
            ("near(p.this, q.this, 1e300)", None),
            ("touching(p.this, q.this)", None),
            ("touching(q.this, p.this, half)", None),
            ("on(p.this, q.this)", [["floor", "b0"], ["floor", "b1"], ["floor", "b2"], ["floor", "b3"]]),
            ("supports(q.this, p.this) AND collides(p.this, q.this)", None),
            ("contains(p.this, q.this)", None),
            ("near(p.this, q.this, 0.1) AND near(q.this, p.this, 0.1)", None),
            ("near(p.this, q.this, mass(p.this))", None),
            ("near(p.this, p.this, 0.1)", []),
        )
    ),
]  # fmt: skip
