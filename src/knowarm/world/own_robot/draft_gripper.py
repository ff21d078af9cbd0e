"""Arm and gripper of a bare MJCF file: the joints that the agent moves, and the TCP."""

import re
from dataclasses import dataclass

import mujoco
import numpy as np

from knowarm.arrays import Floats
from knowarm.errors import UserError

GRIPPER_WORDS = re.compile(r"grip|finger|jaw|knuckle|driver|claw|thumb", re.IGNORECASE)
"""Joints with these words in their name open the gripper."""

SITE_WORDS = ("tcp", "pinch", "grasp", "grip", "ee", "end", "tool", "attach", "flange")
"""Sites at the tool centre point have one of these words in their name, best first."""

AGREEING_COSINE = 0.7  # From this cosine on a site's z axis counts as the approach direction
TOOL_M = 0.05  # Distance of the tool centre point in front of an arm that ends at its flange [m]
_MOVABLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


@dataclass(frozen=True, kw_only=True)
class Gripper:
    """What was found of the arm and its tool centre point (TCP)."""

    joints: tuple[str, ...]  # Names of the arm's joints, base to tip
    tcp: dict[str, object]  # The fields ``tcp_...`` of the description
    how: str  # How the joints and the TCP were chosen


def find_gripper(model: mujoco.MjModel) -> Gripper:
    """Find the arm's joints along the kinematic chain, and the TCP at its end."""
    joints, hand = _chain(model)
    if len(joints) < 2:
        raise UserError(
            "The file has no chain of at least two named hinge or slide joints; an arm needs them. "
            "Name its joints, or list them in the description's field joints."
        )
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    inside = _subtree(model, hand)
    outer = [b for b in inside if b != hand and model.body_jntnum[b] > 0]
    sites = sorted(
        (_site_rank(model.site(s).name), s)
        for s in range(model.nsite)
        if model.site_bodyid[s] in inside and model.site(s).name
    )
    names = tuple(model.joint(j).name for j in joints)
    count = f"{len(names)} joints up to body {model.body(hand).name!r}"
    approach, tip = _approach(model, data, joints[-1], hand, outer)
    across = _across(model, data, outer, approach)
    rank, site = sites[0] if sites else (len(SITE_WORDS), -1)
    if rank < len(SITE_WORDS):
        name = model.site(site).name
        own = data.site_xmat[site].reshape(3, 3)
        if own[:, 2] @ approach > AGREEING_COSINE and abs(own[:, 1] @ across) > AGREEING_COSINE:
            return Gripper(joints=names, tcp={"tcp_site": name}, how=f"{count}; TCP: site {name!r}")
        place, source = data.site_xpos[site], f"the place of site {name!r}, turned"
    elif outer:
        place, source = tip, "between the ends of the gripper's fingers"
    else:
        place, source = tip + TOOL_M * approach, f"{TOOL_M} m in front of the last body"
    rotation = data.xmat[hand].reshape(3, 3)
    frame = np.stack([np.cross(across, approach), across, approach], axis=1)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, (rotation.T @ frame).ravel())
    taken = {model.site(s).name for s in range(model.nsite)}
    tcp = {
        "tcp_site": next(name for name in ("tcp", "knowarm_tcp", "tcp_") if name not in taken),
        "tcp_body": model.body(hand).name,
        "tcp_position_m": tuple(np.round(rotation.T @ (place - data.xpos[hand]), 5).tolist()),
        "tcp_quaternion": tuple(np.round(quaternion, 6).tolist()),
    }
    return Gripper(joints=names, tcp=tcp, how=f"{count}; TCP: {source}")


def _chain(model: mujoco.MjModel) -> tuple[list[int], int]:
    """Return the joints from the base to a branch or gripper, and the last body that they move."""
    moved = [[j for j in range(model.njnt) if model.jnt_bodyid[j] == b] for b in range(model.nbody)]
    amount = [sum(len(moved[b]) for b in _subtree(model, body)) for body in range(model.nbody)]
    joints: list[int] = []
    body, hand = 0, 0
    while True:
        branches = [
            b
            for b in range(1, model.nbody)
            if model.body_parentid[b] == body
            and amount[b]
            and not any(GRIPPER_WORDS.search(model.joint(j).name) for j in moved[b])
        ]
        # Several branches at the end are fingers; below, the one with the most joints is the arm.
        if not branches or (len(branches) > 1 and len(joints) >= 3):
            break
        body = max(branches, key=lambda b: amount[b])
        own = [j for j in moved[body] if model.jnt_type[j] in _MOVABLE and model.joint(j).name]
        joints += own
        hand = body if own else hand
    # Fixed bodies between the last joint and the fingers carry them.
    return joints, body if joints and model.body(body).name else hand


def _subtree(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the ids of a body and all that hang on it."""
    inside = [body]
    for b in range(body + 1, model.nbody):
        if model.body_parentid[b] in inside:
            inside.append(b)
    return inside


def _site_rank(name: str) -> int:
    """Return the index of the first word in a site's name, or their number."""
    words = [i for i, word in enumerate(SITE_WORDS) if word in name.lower()]
    return min(words, default=len(SITE_WORDS))


def _approach(
    model: mujoco.MjModel, data: mujoco.MjData, last: int, hand: int, fingers: list[int]
) -> tuple[Floats, Floats]:
    """Return the direction out of the hand, world, and the point where hand or fingers end."""
    origin = data.xanchor[last]
    bodies = fingers or _subtree(model, hand)
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
    for g in geoms:
        middle, half = model.geom_aabb[g, :3], model.geom_aabb[g, 3:]
        rotation = data.geom_xmat[g].reshape(3, 3)
        local = rotation.T @ approach
        centre = float((data.geom_xpos[g] + rotation @ middle) @ approach)
        end = max(end, centre + float(np.abs(local) @ half))
    # Fingers grasp a little before their ends.
    end -= 0.1 * (end - float(origin @ approach)) if fingers else 0.0
    middle = centres.mean(axis=0) if fingers else origin
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
    candidates += [np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])]
    for candidate in candidates:
        flat = candidate - (candidate @ approach) * approach
        length = float(np.linalg.norm(flat))
        if length > 0.3 * float(np.linalg.norm(candidate)) > 0:
            return np.asarray(flat / length)
    raise AssertionError("one of two perpendicular directions lies across the approach")
