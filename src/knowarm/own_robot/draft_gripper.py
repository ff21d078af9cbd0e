"""Arm and gripper of a bare MJCF file: the joints that the agent moves, and the TCP."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from knowarm.arrays import Floats
from knowarm.errors import UserError
from knowarm.own_robot.draft_chain import (
    JAW_SHARE,
    SITE_WORDS,
    extent,
    find_chain,
    fixed_to,
    follow_joints,
    joint_name,
    site_rank,
    subtree,
)

AGREEING_COSINE = 0.7  # From this cosine on a site's z axis counts as the approach direction
TOOL_M = 0.05  # Distance of the tool centre point in front of an arm that ends at its flange [m]


@dataclass(frozen=True, kw_only=True)
class Gripper:
    """What was found of the arm and its tool centre point (TCP)."""

    joints: tuple[str, ...]  # Names of the arm's joints, base to tip
    fields: dict[str, Any]  # Fields of the description: ``tcp_...``, ``fingers``, ``held_joints``
    how: str  # How the joints and the TCP were chosen


def find_gripper(model: mujoco.MjModel, given: Sequence[str] = ()) -> Gripper:
    """Find the arm's joints along the kinematic chain, and the TCP at its end.

    ``given`` are the joints of the arm where the file has several, base to tip.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    if given:
        (joints, hand, end), others = follow_joints(model, given), list[int]()
    else:
        (joints, hand, end), others = find_chain(model, data, 0)
    if len(joints) < 2:
        raise UserError(
            "The file has no chain of at least two named hinge or slide joints; an arm needs them. "
            "Name its joints, or list them in the description's field joints."
        )
    inside = subtree(model, hand)
    outer = [b for b in inside if b != hand and model.body_jntnum[b] > 0]
    sites = sorted(
        (site_rank(model.site(s).name), s)
        for s in range(model.nsite)
        if model.site_bodyid[s] in inside and model.site(s).name
    )
    names = tuple(model.joint(j).name for j in joints)
    left = [joint_name(model, j) for j in range(model.njnt) if j not in joints]
    count = (
        f"{len(names)} joints up to body {model.body(hand).name!r}, where {end}: "
        f"{', '.join(names)}; left out: {', '.join(left) or 'none'}"
    )
    for other in others:
        arm = [model.joint(j).name for j in find_chain(model, data, other)[0][0]]
        count += f"; another arm: joints = {json.dumps(arm)}"
    approach, tip = _approach(model, data, joints[-1], hand, outer)
    across = _across(model, data, outer, approach)
    rank, site = sites[0] if sites else (len(SITE_WORDS), -1)
    if rank < len(SITE_WORDS):
        name = model.site(site).name
        own = data.site_xmat[site].reshape(3, 3)
        if own[:, 2] @ approach > AGREEING_COSINE and abs(own[:, 1] @ across) > AGREEING_COSINE:
            fields = {"tcp_site": name, **_fingers(model, data, outer, across)}
            return Gripper(joints=names, fields=fields, how=f"{count}; TCP: site {name!r}")
        point, source = data.site_xpos[site], f"the place of site {name!r}, turned"
    elif outer:
        point, source = tip, "between the ends of the gripper's fingers"
    else:
        point, source = tip + TOOL_M * approach, f"{TOOL_M} m in front of the last body"
    rotation = data.xmat[hand].reshape(3, 3)
    frame = np.stack([np.cross(across, approach), across, approach], axis=1)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, (rotation.T @ frame).ravel())
    taken = {model.site(s).name for s in range(model.nsite)}
    fields = {
        "tcp_site": next(name for name in ("tcp", "knowarm_tcp", "tcp_") if name not in taken),
        "tcp_body": model.body(hand).name,
        "tcp_position_m": tuple(np.round(rotation.T @ (point - data.xpos[hand]), 5).tolist()),
        "tcp_quaternion": tuple(np.round(quaternion, 6).tolist()),
        **_fingers(model, data, outer, across),
    }
    return Gripper(joints=names, fields=fields, how=f"{count}; TCP: {source}")


def _fingers(
    model: mujoco.MjModel, data: mujoco.MjData, outer: list[int], across: Floats
) -> dict[str, Any]:
    """Return ``fingers`` and their open values in ``held_joints``, if two slide across the hand."""
    slides = [
        j
        for j in range(model.njnt)
        if model.jnt_bodyid[j] in outer
        and model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE
        and model.jnt_limited[j]
        and abs(data.xaxis[j] @ across) > AGREEING_COSINE
    ]
    bodies = [int(model.jnt_bodyid[j]) for j in slides]
    names = [model.body(b).name for b in bodies]
    if len(slides) != 2 or bodies[0] == bodies[1] or not all(names):
        return {}
    geoms = [data.geom_xpos[model.geom_bodyid == b].mean(axis=0) for b in bodies if b]
    outward = np.sign((geoms[0] - geoms[1]) @ across) or 1.0
    held = {}
    for joint, sign in zip(slides, (outward, -outward), strict=True):
        opens = sign * float(data.xaxis[joint] @ across) > 0
        held[model.joint(joint).name] = round(float(model.jnt_range[joint, int(opens)]), 5)
    return {"fingers": names, "held_joints": {k: v for k, v in held.items() if k}}


def _approach(
    model: mujoco.MjModel, data: mujoco.MjData, last: int, hand: int, fingers: list[int]
) -> tuple[Floats, Floats]:
    """Return the direction out of the hand, world, and the point where hand or fingers end."""
    origin = data.xanchor[last]
    bodies = fingers or subtree(model, hand)
    geoms = np.flatnonzero(np.isin(model.geom_bodyid, bodies))
    centres = data.geom_xpos[geoms] if len(geoms) else data.xpos[bodies]
    axis = data.xaxis[last].copy()
    out = centres.mean(axis=0) - origin
    if not fingers:  # the mesh of a flange may extend backward; what it carries continues the wrist
        out += data.xpos[bodies[-1]] - data.xpos[model.body_parentid[model.jnt_bodyid[last]]]
    if np.linalg.norm(out) < 1e-6:
        out = axis
    # The last joint mostly turns the hand about the approach; a wrist's hinge lies across it.
    along = float(axis @ out)
    if abs(along) > 0.3 * float(np.linalg.norm(out)):
        approach = axis * np.sign(along)
    else:
        approach = out / max(float(np.linalg.norm(out)), 1e-9)
    end = float((centres @ approach).max())
    end = max(end, extent(model, data, geoms, approach, np.zeros(3)))
    # Fingers grasp a little before their ends.
    end -= 0.1 * (end - float(origin @ approach)) if fingers else 0.0
    middle = centres.mean(axis=0) if fingers else origin
    if len(fingers) == 1 and len(geoms):
        start = float(data.xpos[fingers[0]] @ approach)
        fixed = np.flatnonzero(np.isin(model.geom_bodyid, fixed_to(model, hand)))
        ends = [extent(model, data, np.array([g]), approach, np.zeros(3)) for g in fixed]
        other = fixed[np.array(ends) > start + JAW_SHARE * (end - start)]
        if len(other):  # between the moving jaw and the fixed one
            middle = (middle + data.geom_xpos[other].mean(axis=0)) / 2
    return approach, middle + approach * (end - float(middle @ approach))


def _across(
    model: mujoco.MjModel, data: mujoco.MjData, fingers: list[int], approach: Floats
) -> Floats:
    """Return the direction in which the fingers open, world, perpendicular to the approach."""
    candidates = [data.xpos[a] - data.xpos[fingers[0]] for a in fingers[1:]]
    candidates += [
        data.xaxis[j]
        for j in range(model.njnt)
        if model.jnt_bodyid[j] in fingers and model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE
    ]
    if len(fingers) == 1:  # a jaw that swings
        candidates += [
            np.cross(data.xaxis[j], approach)
            for j in range(model.njnt)
            if model.jnt_bodyid[j] in fingers
        ]
    candidates += [np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])]
    for candidate in candidates:
        flat = candidate - (candidate @ approach) * approach
        length = float(np.linalg.norm(flat))
        if length > 0.3 * float(np.linalg.norm(candidate)) > 0:
            return np.asarray(flat / length)
    raise AssertionError("one of two perpendicular directions lies across the approach")
