"""Relations of joints: their positions, and whether they are open.

In SelectScript, a joint that an entity does not have is an error; an earlier condition may exclude
the entity. Raw SQL evaluates conditions in any order: there, the value for such an entity is NULL,
and an error if no entity of the world has a joint of that name.
"""

from __future__ import annotations

from collections.abc import Callable

from ssduck.simulators.kinematics import CLOSED, OPEN, OPENNESS_TOLERANCE, EntityJoints
from ssduck.sql.relations.common import ENTITY
from ssduck.sql.relations.relation import Parameter, Relation

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


def _share_relation(name: str, default: float, condition: str, about: str) -> Relation:
    """Checks whether joints are open, or closed, by a share of their range."""
    most_open, openness = (
        f'"joints most_open"({_ENTITY_KEY})',
        f'"joints openness"({_ENTITY_KEY}, joint)',
    )
    return Relation(
        name,
        (
            *ENTITY,
            Parameter("joint", "string", "the name of a joint with limits", optional=True),
            Parameter("share", "double", "a share of its range, from 0 to 1", optional=True),
        ),
        "boolean",
        condition.format(most_open, default),
        f"{about} {_OPENNESS} An entity without such joints is neither open nor closed. {_MISSING}",
        formula_with_first_option=condition.format(openness, default),
        formula_with_options=condition.format(openness, _SHARE.format(name)),
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
    _share_relation(
        "isOpen",
        OPEN,
        f"{{}} >= {{}} - {OPENNESS_TOLERANCE}",
        "Checks if a joint of the entity, or any of its joints with limits, is open by at least "
        "a share, 0.5 by default. A share outside 0 to 1 is an error.",
    ),
    _share_relation(
        "isClosed",
        CLOSED,
        f"{{}} BETWEEN -1e300 AND {{}} + {OPENNESS_TOLERANCE}",
        "Checks if a joint of the entity, or each of its joints with limits, is open by at most "
        "a share, 0.05 by default. A share outside 0 to 1 is an error.",
    ),
)
