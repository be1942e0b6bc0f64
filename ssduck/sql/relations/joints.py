"""Relations of joints: their positions, and whether they are open.

In SelectScript it is an error to ask an entity for a joint that it does not have; a condition
before may leave it out. Raw SQL's conditions come in no order: there, it is unknown of such an
entity, and an error if no entity of the world has a joint of that name.
"""

from __future__ import annotations

from collections.abc import Callable

from ssduck.simulators.joints import CLOSED, OPEN, OPENNESS_TOLERANCE, EntityJoints
from ssduck.sql.relations.common import ENTITY
from ssduck.sql.relations.relation import Parameter, Relation

_OF = "$world, object.tick, object.id"
_OPENNESS = (
    "How far a joint is open is a share of its range from its closed end, which is that of its two "
    "limits that is nearer to 0, or the lower one."
)


_MISSING = (
    "A name that no joint of the object has is an error; in raw SQL it is NULL where another "
    "entity has such a joint."
)


# A share of another kind, percents say, would be an answer to no question.
_SHARE = (
    "CASE WHEN share < 0 OR share > 1 THEN "
    "error('{}: the share is a number from 0 to 1, not ' || share)::DOUBLE "
    "ELSE share::DOUBLE END"
)


def _has_share(name: str, usual: float, condition: str, about: str) -> Relation:
    """Checks whether joints are open, or closed, by a share of their range."""
    most, named = f'"joints most_open"({_OF})', f'"joints openness"({_OF}, joint)'
    return Relation(
        name,
        (
            *ENTITY,
            Parameter("joint", "string", "the name of a joint that has limits", optional=True),
            Parameter("share", "double", "a share of its range, from 0 to 1", optional=True),
        ),
        "boolean",
        condition.format(most, usual),
        f"{about} {_OPENNESS} What has no joints with limits is neither open nor closed. "
        f"{_MISSING}",
        formula_with_first_option=condition.format(named, usual),
        formula_with_options=condition.format(named, _SHARE.format(name)),
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
        f'"joints position"({_OF}, name)',
        "Returns the position of a joint of the object: radians of a revolute one, metres of a "
        f"prismatic one. {_MISSING}",
        unit="rad or m",
        python_table="joints",
        may_fail=True,
    ),
    _has_share(
        "isOpen",
        OPEN,
        f"{{}} >= {{}} - {OPENNESS_TOLERANCE}",
        "Checks if a joint of the object, or any of its joints that have limits, is open by at "
        "least a share of its range, one half if it is not given. A share that is not from 0 to 1 "
        "is an error.",
    ),
    _has_share(
        "isClosed",
        CLOSED,
        f"{{}} BETWEEN -1e300 AND {{}} + {OPENNESS_TOLERANCE}",
        "Checks if a joint of the object, or all of its joints that have limits, are open by at "
        "most a share of their range, 0.05 if it is not given. A share that is not from 0 to 1 is "
        "an error.",
    ),
)
