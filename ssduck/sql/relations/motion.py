"""Relations of motion, attitude and joints.

In SelectScript, a joint that an entity does not have is an error; an earlier condition may exclude
the entity. Raw SQL evaluates conditions in any order: there, the value for such an entity is NULL,
and an error if no entity of the world has a joint of that name.
"""

from __future__ import annotations

from collections.abc import Callable

from ssduck.simulators.kinematics import CLOSED, OPEN, OPENNESS_TOLERANCE, EntityJoints
from ssduck.sql.relations.common import ENTITY, entity_relation, if_from_0_up
from ssduck.sql.relations.relation import Parameter, Relation

# What `settled` and `upright` take by default: m/s, rad/s and rad.
SLOW, SLOW_TURN, UPRIGHT = 0.01, 0.1, 0.2

_SPEED = "sqrt(object.vx ** 2 + object.vy ** 2 + object.vz ** 2)"
_TURN = "sqrt(object.wx ** 2 + object.wy ** 2 + object.wz ** 2)"
# The angle between the z axes of the object's frame and of the world. Unlike the arc cosine of
# their product, it is exact near 0.
_TILT = "2 * atan2(sqrt(object.qx ** 2 + object.qy ** 2), sqrt(object.qw ** 2 + object.qz ** 2))"


# The functions of an entity's links but its base, as SQL calls them: the greatest magnitude of
# these columns of the table of links, 0 where there are none.
LINK_SPEED_UDFS = {"links speed": ("vx", "vy", "vz"), "links turn": ("wx", "wy", "wz")}


def link_speed_lookup(name: str) -> str:
    """Returns what one of `LINK_SPEED_UDFS` is as a formula that reads the table of links."""
    speed = " + ".join(f"links.{column} ** 2" for column in LINK_SPEED_UDFS[name])
    fastest = (
        f"SELECT links.entity AS entity, max(sqrt({speed})) AS speed FROM links "  # noqa: S608
        "WHERE links.link <> 0 GROUP BY ALL"
    )
    found = f"(SELECT map(list(entity), list(speed)) FROM ({fastest}) AS fastest)"  # noqa: S608
    return f"COALESCE(map_extract_value({found}, object.id), 0)"


def _is_slow(linear: str, angular: str) -> str:
    key = "$world, object.tick, object.id"
    return (
        f"{_SPEED} <= {linear} AND {_TURN} <= {angular} "
        f'AND "links speed"({key}) <= {linear} AND "links turn"({key}) <= {angular}'
    )


MOTION_RELATIONS: tuple[Relation, ...] = (
    entity_relation(
        "speed",
        "double",
        _SPEED,
        "Returns the magnitude of the velocity of the entity's link frame in the world frame.",
        "m/s",
    ),
    entity_relation(
        "angularSpeed",
        "double",
        _TURN,
        "Returns the magnitude of the entity's angular velocity.",
        "rad/s",
    ),
    entity_relation(
        "tilt",
        "double",
        _TILT,
        "Returns the angle between the z axis of the entity's link frame and the world's z axis, "
        "from 0 to pi.",
        "rad",
    ),
    Relation(
        "upright",
        (*ENTITY, Parameter("angle", "double", "the greatest tilt, rad", True, f"{UPRIGHT}")),
        "boolean",
        f"{_TILT} <= {UPRIGHT}",
        "Checks if the z axis of the entity's link frame is at most an angle from the world's z "
        f"axis, {UPRIGHT} rad (11 degrees) by default. A negative angle is an error.",
        options=(if_from_0_up("upright", f"{_TILT} <= angle", angle="an angle, rad"),),
        margin="angle - tilt(object)",
    ),
    Relation(
        "settled",
        (
            *ENTITY,
            Parameter("linear", "double", "the greatest speed, m/s", optional=True),
            Parameter("angular", "double", "the greatest angular speed, rad/s", optional=True),
        ),
        "boolean",
        _is_slow(str(SLOW), str(SLOW_TURN)),
        f"Checks if the speed of each link of the entity is at most {SLOW} m/s and its angular "
        f"speed at most {SLOW_TURN} rad/s, or at most the given ones; speed and angularSpeed are "
        "those of the base alone. heldFor(settled(object)) >= 0.2 is true if that has held for "
        "0.2 s. A negative speed is an error.",
        python_table="links",
        options=(
            if_from_0_up("settled", _is_slow("linear", str(SLOW_TURN)), linear="a speed, m/s"),
            if_from_0_up(
                "settled",
                _is_slow("linear", "angular"),
                linear="a speed, m/s",
                angular="an angular speed, rad/s",
            ),
        ),
    ),
)


_ENTITY_KEY = "$world, object.tick, object.id"
_OPENNESS = (
    "The share is that of the joint's range, from its closed end: the limit nearer to 0, or the "
    "lower one of two equally near."
)


_MISSING = (
    "A name of no joint of the entity is an error; in raw SQL, the value is NULL if another "
    "entity has such a joint."
)


# A share outside 0 to 1, in percent for example, is an error.
_SHARE = (
    "CASE WHEN share < 0 OR share > 1 THEN "
    "error('{}: the share is a number from 0 to 1, not ' || share)::DOUBLE "
    "ELSE share::DOUBLE END"
)


_MOST_OPEN, _OPEN_SHARE = (
    f'"joints most_open"({_ENTITY_KEY})',
    f'"joints openness"({_ENTITY_KEY}, joint)',
)
_JOINT = Parameter("joint", "string", "the name of a joint with limits", optional=True)


def _share_relation(name: str, default: float, condition: str, margin: str, about: str) -> Relation:
    """Checks whether joints are open, or closed, by a share of their range."""
    return Relation(
        name,
        (
            *ENTITY,
            _JOINT,
            Parameter("share", "double", "a share of its range, from 0 to 1", True, str(default)),
        ),
        "boolean",
        condition.format(_MOST_OPEN, default),
        f"{about} {_OPENNESS} An entity without such joints is neither open nor closed. {_MISSING}",
        options=(
            condition.format(_OPEN_SHARE, default),
            condition.format(_OPEN_SHARE, _SHARE.format(name)),
        ),
        margin=margin.format("openness(object)"),
        margin_with_options=margin.format("openness(object, joint)"),
        python_table="joints",
        may_fail=True,
    )


# The functions of joints, as SQL calls them: the types of their parameters after an entity.
JOINT_UDFS: dict[str, tuple[Callable[..., float | None], tuple[str, ...]]] = {
    "joints position": (EntityJoints.position, ("VARCHAR",)),
    "joints openness": (EntityJoints.openness, ("VARCHAR",)),
    "joints most_open": (EntityJoints.most_open, ()),
}

JOINT_RELATIONS: tuple[Relation, ...] = (
    Relation(
        "joint",
        (*ENTITY, Parameter("name", "string", "the name of a revolute or prismatic joint")),
        "double",
        f'"joints position"({_ENTITY_KEY}, name)',
        "Returns the position of a joint of the entity, in radians for a revolute joint and in "
        f"metres for a prismatic one. {_MISSING}",
        unit="rad or m",
        python_table="joints",
        may_fail=True,
    ),
    Relation(
        "openness",
        (*ENTITY, _JOINT),
        "double",
        _MOST_OPEN,
        f"Returns by how much of its range a joint of the entity is open, from 0 to 1; without a "
        f"joint, that of the one that is open farthest, minus infinity if none has limits. "
        f"{_OPENNESS} {_MISSING}",
        options=(_OPEN_SHARE,),
        python_table="joints",
        may_fail=True,
    ),
    _share_relation(
        "isOpen",
        OPEN,
        f"{{}} >= {{}} - {OPENNESS_TOLERANCE}",
        f"{{}} - share + {OPENNESS_TOLERANCE}",
        "Checks if a joint of the entity, or any of its joints with limits, is open by at least "
        "a share, 0.5 by default. A share outside 0 to 1 is an error.",
    ),
    _share_relation(
        "isClosed",
        CLOSED,
        f"{{0}} BETWEEN -1e300 AND {{1}} + {OPENNESS_TOLERANCE}",
        f"min([{{0}} + 1e300, share + {OPENNESS_TOLERANCE} - {{0}}])",
        "Checks if a joint of the entity, or each of its joints with limits, is open by at most "
        "a share, 0.05 by default. A share outside 0 to 1 is an error.",
    ),
)
