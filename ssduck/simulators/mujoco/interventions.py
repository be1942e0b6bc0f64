"""Switches the collisions of bodies on and off, hides, removes and connects them.

A compiled model cannot lose or get parts. So a body that does not collide has geoms that meet
nothing, a hidden one is transparent, and a removed one is both and left out of all descriptions. To
connect bodies, welds are needed that the model has already: inactive ones whose names begin with
`HOLD`. ssduck adds some to the models that it loads.
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ssduck.errors import UnsupportedError
from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.poses import compose, invert
from ssduck.simulators.interface import Body
from ssduck.simulators.mujoco.bodies import colliding_geoms, name_of, numbers_of
from ssduck.simulators.mujoco.flexes import flexes_on
from ssduck.simulators.mujoco.library import mujoco

# The beginning of the names of welds that connect what `Entity.hold` holds.
HOLD = "ssduck_hold"
# The number of them that a model gets when it is loaded.
SPARE_WELDS = 8
# A margin at which no two shapes meet.
NEVER = -1e9
_WELD = int(mujoco.mjtEq.mjEQ_WELD)
# The data of a weld that holds nothing: an anchor, a pose as x y z w x y z, the scale of torques.
IDLE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


# -- switches --------------------------------------------------------------------------------


@dataclass(eq=False)
class Switches:
    """The bodies of a model whose collisions are off, and those that are hidden.

    Attributes:
        model: the model.
        disabled: the bodies whose collisions are off; a new set after each change.
        hidden: the bodies that are not drawn, likewise.
    """

    model: Any
    disabled: frozenset[Body] = frozenset()
    hidden: frozenset[Body] = frozenset()
    _saved: dict[tuple[str, Body], dict[str, tuple[Indices, Array]]] = field(default_factory=dict)

    @property
    def disabled_geoms(self) -> Indices:
        """The geoms, then the flexes, that would collide if their bodies were not disabled."""
        saved = [self._saved["enable", body] for body in self.disabled]
        geoms = [parts["geom_contype"][0] for parts in saved]
        flexes = [parts["flex_contype"][0] + self.model.ngeom for parts in saved]
        return np.concatenate([np.zeros(0, np.intp), *geoms, *flexes])

    def enable(self, body: Body, on: bool) -> None:
        """Switches the collisions of a body on or off."""
        if on != (body in self.disabled):
            return
        if on:
            self._restore("enable", body)
            self.disabled -= {body}
            return
        model = self.model
        numbers = colliding_geoms(model)
        numbers = numbers[np.isin(model.geom_bodyid[numbers], numbers_of(body))]
        pairs = np.isin(model.pair_geom1, numbers) | np.isin(model.pair_geom2, numbers)
        self._set("enable", body, ("geom_contype", "geom_conaffinity"), numbers, 0)
        are_of_body = np.isin(np.arange(model.nbody), numbers_of(body))
        flexes = flexes_on(model, are_of_body)
        self._set("enable", body, ("flex_contype", "flex_conaffinity"), flexes, 0)
        self._set("enable", body, ("pair_margin",), np.flatnonzero(pairs), NEVER)
        self.disabled |= {body}

    def show(self, body: Body, on: bool) -> None:
        """Shows or hides a body."""
        if on != (body in self.hidden):
            return
        if on:
            self._restore("show", body)
            self.hidden -= {body}
            return
        model = self.model
        for part, owners in (("geom", model.geom_bodyid), ("site", model.site_bodyid)):
            numbers = np.flatnonzero(np.isin(owners, numbers_of(body)))
            self._set("show", body, (f"{part}_matid",), numbers, -1)
            self._set("show", body, (f"{part}_rgba",), numbers, 0.0)
        self.hidden |= {body}

    def _set(
        self, action: str, body: Body, names: Collection[str], numbers: Indices, value: float
    ) -> None:
        saved = self._saved.setdefault((action, body), {})
        for name in names:
            array = getattr(self.model, name)
            saved[name] = numbers, array[numbers].copy()
            array[numbers] = value

    def _restore(self, action: str, body: Body) -> None:
        _write(self.model, self._saved.pop((action, body)))

    def switched_on(self, model: Any) -> Any:
        """Returns a copy of a copy of the model, in which all bodies collide and are drawn."""
        copied = copy.copy(model)
        for saved in self._saved.values():
            _write(copied, saved)
        return copied


def _write(model: Any, saved: Mapping[str, tuple[Indices, Array]]) -> None:
    for name, (numbers, values) in saved.items():
        getattr(model, name)[numbers] = values


# -- removal ---------------------------------------------------------------------------------


def take_out(model: Any, data: Any, is_gone: Flags) -> None:
    """Takes bodies, (bodies,) flags of whole trees, out of all interactions, and hides them."""
    of_geoms = is_gone[model.geom_bodyid]
    model.geom_contype[of_geoms] = model.geom_conaffinity[of_geoms] = 0
    model.geom_rgba[of_geoms, 3] = 0.0
    of_flexes = flexes_on(model, is_gone)
    model.flex_contype[of_flexes] = model.flex_conaffinity[of_flexes] = 0
    model.flex_rgba[of_flexes, 3] = 0.0
    model.geom_matid[of_geoms] = -1
    model.pair_margin[of_geoms[model.pair_geom1] | of_geoms[model.pair_geom2]] = NEVER
    model.site_rgba[is_gone[model.site_bodyid], 3] = 0.0
    model.site_matid[is_gone[model.site_bodyid]] = -1
    of_dofs = is_gone[model.dof_bodyid]
    data.qvel[of_dofs] = 0.0
    model.body_gravcomp[is_gone] = 1.0
    for number in range(model.neq):
        if any(is_gone[body] for body in _bodies_of_constraint(model, number)):
            data.eq_active[number] = 0


def _bodies_of_constraint(model: Any, number: int) -> list[int]:
    """Returns the bodies that an equality constraint connects, as far as it names any."""
    object_type = int(model.eq_objtype[number])
    owners = {
        int(mujoco.mjtObj.mjOBJ_BODY): np.arange(model.nbody),
        int(mujoco.mjtObj.mjOBJ_JOINT): model.jnt_bodyid,
        int(mujoco.mjtObj.mjOBJ_SITE): model.site_bodyid,
    }.get(object_type)
    if owners is None:
        return []
    ends = (int(model.eq_obj1id[number]), int(model.eq_obj2id[number]))
    return [int(owners[end]) for end in ends if end >= 0]


# -- holding ---------------------------------------------------------------------------------


def add_spare_welds(spec: Any) -> None:
    """Adds inactive welds to a specification, for `Entity.hold`."""
    bodies = list(spec.bodies)[1:]  # without the world body
    if not bodies:
        return
    if not bodies[0].name:
        bodies[0].name = "body_1"  # as ssduck names it
    for number in range(SPARE_WELDS):
        weld = spec.add_equality()
        weld.name = f"{HOLD}_{number}"
        weld.type, weld.objtype = mujoco.mjtEq.mjEQ_WELD, mujoco.mjtObj.mjOBJ_BODY
        weld.name1, weld.active = bodies[0].name, False
        weld.data[: len(IDLE)] = IDLE


def spare_welds(model: Any) -> list[int]:
    """Returns the numbers of the welds by which bodies can be held."""
    names = (name_of(model, mujoco.mjtObj.mjOBJ_EQUALITY, n, "") for n in range(model.neq))
    return [
        n
        for n, name in enumerate(names)
        if name.startswith(HOLD) and int(model.eq_type[n]) == _WELD
    ]


def holds(model: Any, data: Any) -> Iterator[tuple[int, int, int]]:
    """Yields the welds that hold bodies: their numbers, the holding bodies, the held ones."""
    for number in spare_welds(model):
        if data.eq_active[number]:
            yield number, int(model.eq_obj1id[number]), int(model.eq_obj2id[number])


def hold(model: Any, data: Any, poses: Any, holding: int, held: int) -> None:
    """Welds two bodies, by their numbers, together as they are in other data, `poses`."""
    welds = spare_welds(model)
    free = [number for number in welds if not data.eq_active[number]]
    if not free:
        used = f"all {len(welds)} of the model hold something" if welds else "the model has none"
        raise UnsupportedError(
            f"MuJoCo's models have a fixed number of welds, and {used}: release something, or "
            f"declare <weld name='{HOLD}' body1='…' active='false'/> in the model"
        )
    number = free[0]
    position, turn = compose(
        *invert(poses.xpos[holding][None], poses.xquat[holding][None]),
        poses.xpos[held][None],
        poses.xquat[held][None],
    )
    model.eq_obj1id[number], model.eq_obj2id[number] = holding, held
    model.eq_objtype[number] = int(mujoco.mjtObj.mjOBJ_BODY)
    model.eq_data[number, : len(IDLE)] = [*IDLE[:3], *position[0], *turn[0], IDLE[-1]]
    data.eq_active[number] = 1
