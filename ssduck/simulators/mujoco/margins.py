"""The collision margins of a MuJoCo model: how far apart two geoms are at most when they press.

MuJoCo's rule for two geoms depends on its version. Until 3.4, the larger margin counts, less the
larger gap; until 3.8, the sum of both, less both gaps; since then the sum, whatever the gaps. A
<pair> has a margin of its own, and `o_margin` replaces all if the model overrides contacts.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from ssduck.geometry.arrays import Array
from ssduck.geometry.margins import Margins
from ssduck.simulators.mujoco.library import mujoco

# Two spheres in contact, whose margins and gaps tell the rule.
_TWO = """<mujoco><worldbody><geom size=".1" margin=".5" gap=".25"/><body><freejoint/>
<geom size=".1" margin=".125" gap=".0625"/></body></worldbody></mujoco>"""
_OVERRIDE = int(mujoco.mjtEnableBit.mjENBL_OVERRIDE)
_ARRAYS = ("geom_margin", "geom_gap", "flex_margin", "flex_gap", "pair_margin", "pair_gap")


@cache
def _rule() -> tuple[bool, bool]:
    """Returns whether margins are added, and whether gaps are subtracted; MuJoCo itself tells."""
    model = mujoco.MjModel.from_xml_string(_TWO)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    margin = float(data.contact.includemargin[0])
    if margin == 0.5 - 0.25:
        return False, True
    return True, margin == 0.625 - 0.3125


def margin_content(model: Any) -> bytes:
    """Returns the numbers that the margins follow from."""
    numbers = [getattr(model, name).tobytes() for name in (*_ARRAYS, "pair_geom1", "pair_geom2")]
    override = model.opt.o_margin if model.opt.enableflags & _OVERRIDE else -1.0
    return b"".join((*numbers, np.float64(override).tobytes()))


def margins_of(model: Any) -> Margins:
    """Returns the margins of the geoms of a model, followed by those of its flexes."""
    are_added, has_gaps = _rule()
    own = np.concatenate((model.geom_margin, model.flex_margin))
    gaps = np.concatenate((model.geom_gap, model.flex_gap)) * has_gaps
    of_pairs, pair_gaps = model.pair_margin.copy(), model.pair_gap * has_gaps
    if model.opt.enableflags & _OVERRIDE:
        of_pairs[of_pairs >= 0.0] = model.opt.o_margin
        own[:] = model.opt.o_margin * (0.5 if are_added else 1.0)
    # Pairs of what is disabled never meet; they keep the margins of their geoms.
    is_on = of_pairs >= 0.0
    first, second = model.pair_geom1[is_on], model.pair_geom2[is_on]
    of_pairs = np.maximum(of_pairs - pair_gaps, 0.0)[is_on]
    if are_added:
        numbers = own - gaps
        if (numbers >= 0.0).all() and np.array_equal(numbers[first] + numbers[second], of_pairs):
            return Margins(numbers)
    # Geoms of a <pair> are a class each, all others by what they have.
    is_of_pair = np.isin(np.arange(len(own)), np.concatenate((first, second)))
    keys = np.column_stack((own, gaps, np.where(is_of_pair, np.arange(len(own)), -1)))
    kinds, classes = np.unique(keys, axis=0, return_inverse=True)
    classes = classes.reshape(-1)
    of_classes = _combined(kinds[:, 0], are_added) - _combined(kinds[:, 1], are_added)
    of_classes = np.maximum(of_classes, 0.0)
    one, other = classes[first], classes[second]
    of_classes[one, other] = of_classes[other, one] = of_pairs
    # A half of the largest: the sum of two is at least their margin.
    numbers = 0.5 * of_classes.max(axis=1, initial=0.0)
    if np.array_equal(numbers[:, None] + numbers, of_classes):
        return Margins(numbers[classes])
    return Margins(numbers[classes], classes, of_classes)


def _combined(numbers: Array, are_added: bool) -> Array:
    """Returns what the numbers of each two classes make."""
    combine = np.add if are_added else np.maximum
    combined: Array = combine(numbers[:, None], numbers)
    return combined
