"""Closeness: how near each geom of a model can come to the camera, over states of its joints."""

import mujoco
import numpy as np
import scipy
from numpy.typing import NDArray

STATES = 512
"""States of the joints that are tried."""

NEAREST_M = 0.2
"""Least distance that is assumed: nearer, a geom would fill the image [m]."""

FREE_SHARE = 0.5
"""Share of its distance at rest to which a body that is placed from outside may come nearer."""


def closest_depths(
    model: mujoco.MjModel, view: NDArray[np.float32], half_height: float, aspect: float
) -> NDArray[np.float64]:
    """Return the smallest depth at which each geom can be in the image [m], (G,).

    The joints take a Halton sequence over their ranges, one turn where they have none. Bodies that
    are placed from outside, by mocap or free joints, stay where the model has them.

    Args:
        model: the geoms and joints.
        view: position [m] and row-major rotation of the camera, (12,).
        half_height: half the image's height at depth 1.
        aspect: width of the image by its height.
    """
    movable = np.isin(
        model.jnt_type, (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    )
    joints = np.flatnonzero(movable)
    limited = model.jnt_limited[joints].astype(np.bool_)[:, None]
    ranges = np.where(limited, model.jnt_range[joints], [-np.pi, np.pi])
    count = STATES if len(joints) else 1
    halton = scipy.stats.qmc.Halton(max(1, len(joints)), scramble=False)
    share = halton.random(count)[:, : len(joints)]
    values = ranges[:, 0] + share * (ranges[:, 1] - ranges[:, 0])
    data = mujoco.MjData(model)
    eye, rotation = view[:3].astype(np.float64), view[3:].reshape(3, 3).astype(np.float64)
    radius = np.where(model.geom_rbound > 0, model.geom_rbound, 0.0)
    wide = half_height * max(1.0, aspect) + 0.1
    closest = np.full(model.ngeom, np.inf)
    for state in values:
        data.qpos[model.jnt_qposadr[joints]] = state
        mujoco.mj_kinematics(model, data)
        place = (data.geom_xpos - eye) @ rotation
        depth = -place[:, 2]
        sideways = np.abs(place[:, :2]).max(axis=1)
        seen = (depth > -radius) & (sideways - 1.5 * radius < wide * np.maximum(depth, radius))
        closest = np.where(seen, np.minimum(closest, depth - radius), closest)
    # A geom that was never seen may still reach into the image: as if at its distance at rest.
    mujoco.mj_resetData(model, data)
    mujoco.mj_kinematics(model, data)
    rest = np.linalg.norm(data.geom_xpos - eye, axis=1) - radius
    closest = np.where(np.isfinite(closest), closest, rest)
    root = model.body_rootid[model.geom_bodyid]
    free = np.isin(root, model.jnt_bodyid[~movable]) | (model.body_mocapid[root] >= 0)
    return np.maximum(np.where(free, FREE_SHARE * closest, closest), NEAREST_M)
