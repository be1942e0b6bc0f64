"""Worlds for the tests of copies."""

import numpy as np
import pytest

import ssduck
from ssduck.sandbox.references import EntityReference
from ssduck.sql.relations.registry import RELATIONS

pybullet = pytest.importorskip("pybullet")


def state(world):
    """All numbers of all entities, by name."""
    return {
        entity.name: np.array(
            [
                *entity.pose,
                *entity.velocity,
                *np.ravel(entity.aabb),
                entity.mass,
                entity.enabled,
                entity.visible,
                *(number for j in entity.joints for number in (j.position, j.velocity)),
                *(number for one in entity.links for number in (*one.position, one.mass)),
            ]
        )
        for entity in world
    }


def farthest(first, second, names=None):
    """By how much the worlds' numbers differ at most; of these entities only."""
    a, b = state(first), state(second)
    names = a.keys() if names is None else names
    assert set(names) == b.keys()
    return max((float(np.abs(a[name] - b[name]).max()) for name in names), default=0.0)


def told_relations():
    """Relations of one entity or two, as programs write them."""
    for name, relation in RELATIONS.items():
        needed = [p for p in relation.parameters if not p.optional]
        if name != "tick" and all(p.type in ("entity", "place") for p in needed):
            yield name, len(needed)


ONE = sorted(name for name, count in told_relations() if count == 1)

TWO = sorted(name for name, count in told_relations() if count == 2)


def by_name(value):
    """A value with names for entities, which are of different worlds."""
    if isinstance(value, ssduck.Entity | EntityReference):
        return value.name
    if isinstance(value, list | tuple):
        return [by_name(part) for part in value]
    if isinstance(value, dict):
        return {key: by_name(part) for key, part in value.items()}
    return value


def relations(world, names, *, skipped=frozenset()):
    """What all relations tell of some entities."""
    ss = ssduck.Interpreter()
    ss.add_variable("w", world)
    ss.add_variable("names", list(names))
    told = {}
    for name in ONE:
        if name not in skipped:
            program = f"SELECT id(this), {name}(this) FROM w WHERE id(this) IN names AS list;"
            told[name] = by_name(ss.eval(program))
    for name in TWO:
        if name not in skipped:
            told[name] = by_name(
                ss.eval(
                    f"SELECT id(a.this), id(b.this), {name}(a.this, b.this) FROM a = w, b = w "
                    "WHERE id(a.this) IN names AND id(b.this) IN names AS list;"
                )
            )
    return told


def dynamics(world):
    """What PyBullet tells of the links: masses, inertias, friction and so on; colours."""
    client = world.simulator.client
    return {
        member.name: (
            [
                np.round([*told[:2], *told[2], *told[3], *told[4], *told[5:10]], 12).tolist()
                for i in range(-1, len(member.body.joints))
                for told in [pybullet.getDynamicsInfo(member.body.handle, i, client)]
            ],
            [
                pybullet.getJointInfo(member.body.handle, i, client)[6]
                for i in range(len(member.body.joints))
            ],
            [
                entry[7]
                for entry in pybullet.getVisualShapeData(member.body.handle, physicsClientId=client)
            ],
        )
        for member in world.snapshot.load_order
        if member.body is not None
    }


def constraints(world):
    """What PyBullet tells of the constraints."""
    client = world.simulator.client
    numbers = [
        pybullet.getConstraintUniqueId(i, physicsClientId=client)
        for i in range(pybullet.getNumConstraints(client))
    ]
    return [pybullet.getConstraintInfo(number, client)[4:] for number in numbers]


MOTORS = "arm: the motors are not known"
