"""The matrices of a camera and of the light: columns act on (x, y, z, 1)."""

from __future__ import annotations

import math

import numpy as np

from ssduck.geometry.arrays import Array

# The direction to the light.
SUN = np.array([0.35, -0.45, 0.82]) / np.linalg.norm([0.35, -0.45, 0.82])
NEAR = 0.02


def look_at(eye: Array, target: Array) -> Array:
    """Returns the transformation (4, 4) from the world to a camera that looks along its -z."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.999 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(right, forward), -forward])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, -rotation @ eye
    return matrix


def projection(fov: float, aspect: float, far: float) -> Array:
    """Returns OpenGL's perspective projection (4, 4).

    Args:
        fov: the vertical field of view, degrees.
        aspect: the width divided by the height.
        far: the greatest distance that is drawn, m.
    """
    scale = 1.0 / math.tan(math.radians(fov) / 2)
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[1, 1] = scale / aspect, scale
    matrix[2, 2], matrix[2, 3] = -(far + NEAR) / (far - NEAR), -2 * far * NEAR / (far - NEAR)
    matrix[3, 2] = -1.0
    return matrix


def sun_matrix(centre: Array, radius: float) -> Array:
    """Returns the projection (4, 4) of the light, which covers a sphere."""
    matrix = np.eye(4)
    view = look_at(centre + SUN * 2 * radius, centre)
    matrix[0, 0] = matrix[1, 1] = 1 / radius
    matrix[2, 2], matrix[2, 3] = -1 / (1.5 * radius), -2 * radius / (1.5 * radius)
    return matrix @ view
