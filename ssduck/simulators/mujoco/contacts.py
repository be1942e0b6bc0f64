"""Reads the contact points of a MuJoCo simulation into arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.simulators.interface import ContactPoints
from ssduck.simulators.mujoco.library import mujoco


def read_contacts(model: Any, data: Any) -> ContactPoints:
    """Returns the contact points of the last step between geoms.

    MuJoCo's normal points from the first geom to the second. Points at a distance, which margins
    allow, count if they press.
    """
    count = data.ncon
    if not count:
        return ContactPoints.none()
    contact = data.contact
    geoms = contact.geom
    forces = _forces(model, data, contact)
    are_geoms = (geoms[:, 0] >= 0) & (geoms[:, 1] >= 0)
    is_kept = are_geoms & ((contact.dist <= 0.0) | (forces[:, 0] > 0.0))
    if not is_kept.any():
        return ContactPoints.none()
    frames, distances, middles = contact.frame, contact.dist, contact.pos
    if not is_kept.all():
        forces, geoms, frames = forces[is_kept], geoms[is_kept], frames[is_kept]
        distances, middles = distances[is_kept], middles[is_kept]
    frames, depths = frames.reshape(-1, 3, 3), -distances
    numbers = model.geom_bodyid[geoms].astype(np.intp)
    roots = model.body_rootid[numbers].astype(np.intp)
    half = 0.5 * depths[:, None] * frames[:, 0]
    points = np.zeros((len(depths), 2, 3))
    np.add(middles, half, out=points[:, 0])
    np.subtract(middles, half, out=points[:, 1])
    return ContactPoints(
        bodies=roots,
        links=numbers - roots,
        points=points,
        normals=-frames[:, 0],
        depths=depths,
        forces=forces[:, 0],
        frictions=-np.einsum("nk,nki->ni", forces[:, 1:], frames[:, 1:]),
    )


def _forces(model: Any, data: Any, contact: Any) -> Array:
    """Returns the forces of the first geoms on the second in the frames of contacts, (n, 3).

    They are the normal force and the two friction forces, as `mj_contactForce` returns them.
    """
    addresses: Indices = contact.efc_address.astype(np.intp)
    dims = contact.dim
    efc = data.efc_force
    forces = np.zeros((len(addresses), 3))
    is_active = addresses >= 0
    if not is_active.any():
        return forces
    pyramidal = model.opt.cone == int(mujoco.mjtCone.mjCONE_PYRAMIDAL)
    # Most contacts are of one dimension, and all press.
    is_uniform = is_active.all() and (dims == dims[0]).all()
    for dim in dims[:1].tolist() if is_uniform else np.unique(dims[is_active]).tolist():
        rows = np.arange(len(dims)) if is_uniform else np.flatnonzero(is_active & (dims == dim))
        first = addresses[rows]
        if not pyramidal or dim == 1:
            axes = min(dim, 3)
            forces[rows, :axes] = efc[first[:, None] + np.arange(axes)]
            continue
        # A pyramid has two edges for each axis of friction, whose forces add up to the normal one.
        edges = efc[first[:, None] + np.arange(2 * (dim - 1))].reshape(len(rows), dim - 1, 2)
        forces[rows, 0] = edges.sum(axis=(1, 2))
        axes = min(dim - 1, 2)
        differences = edges[:, :axes, 0] - edges[:, :axes, 1]
        forces[rows, 1 : 1 + axes] = differences * contact.friction[rows, :axes]
    return forces
