"""The nearest point of an ellipsoid, for points on and beside its planes of symmetry."""

import math

import numpy as np
import pytest
from scipy.optimize import minimize

from ssduck.geometry.ellipsoids import nearest_on_ellipsoid
from tests.support.cases import generated

# Coordinates beside a plane of symmetry, as fractions of the half length.
TINY = (0.0, 1e-300, 1e-21, 1e-19, 1e-18, 1e-15, 1e-9)


def on_surface(semi_axes, angles):
    polar, azimuth = angles
    across = np.sin(polar)
    parts = across * np.cos(azimuth), across * np.sin(azimuth), np.cos(polar)
    return np.stack([s * part for s, part in zip(semi_axes, parts, strict=True)], axis=-1)


def least_distance(semi_axes, point):
    """The least distance of many points of the surface, improved by a search from the nearest."""
    angles = np.meshgrid(np.linspace(0, np.pi, 91), np.linspace(0, 2 * np.pi, 181))
    squared = ((on_surface(semi_axes, angles) - point) ** 2).sum(axis=-1)
    place = np.unravel_index(squared.argmin(), squared.shape)
    found = minimize(
        lambda angles: ((on_surface(semi_axes, angles) - point) ** 2).sum(),
        [angle[place] for angle in angles],
        method="Nelder-Mead",
        options={"xatol": 1e-10, "fatol": 1e-18},
    )
    return math.sqrt(min(found.fun, squared[place]))


@pytest.mark.parametrize("seed", range(generated(40)))
def test_no_point_of_the_surface_is_nearer(seed):
    rng = np.random.default_rng(seed)
    semi_axes = tuple(np.exp(rng.uniform(-3, 1, 3)).tolist())
    factors = [rng.choice(TINY) if rng.random() < 0.4 else rng.normal() for _ in range(3)]
    point = [float(f * s) for f, s in zip(factors, semi_axes, strict=True)]
    nearest = nearest_on_ellipsoid(semi_axes, point)
    level = sum((n / s) ** 2 for n, s in zip(nearest, semi_axes, strict=True))
    assert level == pytest.approx(1.0, abs=1e-9)
    assert math.dist(nearest, point) <= least_distance(semi_axes, point) + 1e-9


@pytest.mark.parametrize("tiny", TINY[:6])
@pytest.mark.parametrize("axis", range(3))
def test_a_point_beside_the_centre_is_as_far_as_the_centre(tiny, axis):
    for sign in (1.0, -1.0):
        point = [0.0, 0.0, 0.0]
        point[axis] = sign * tiny
        assert math.hypot(*nearest_on_ellipsoid((0.3, 0.1, 0.2), point)) == pytest.approx(0.1)
