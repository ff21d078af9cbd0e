"""Arm of a model: the kinematic chain that ends where fingers begin."""

import re
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from knowarm.arrays import Floats, Integers
from knowarm.errors import unknown_name

GRIPPER_WORDS = re.compile(r"grip|finger|jaw|knuckle|driver|claw|thumb", re.IGNORECASE)
"""Joints with these words in their name open the gripper."""

SITE_WORDS = ("tcp", "pinch", "grasp", "grip", "ee", "end", "tool", "attach", "flange")
"""Sites at the tool centre point have one of these words in their name, best first."""

FIRST_FINGER = (
    3  # A joint is taken for a finger's after at least so many joints of the arm
)
ARM_JOINTS = (
    4  # Several moving parts, of which one has at least so many joints, may be arms
)
ARM_SHARE = (
    0.5  # Arms are at least so long, relative to what carries them; fingers are shorter
)
JAW_SHARE = (
    0.5  # A fixed part that reaches at least so far along a moving one is its other jaw
)
JAW_TRAVEL_M = 0.1  # The last part of an arm slides farther than a jaw
_MOVABLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


class JointChain(NamedTuple):
    """Joints of an arm."""

    joints: list[int]  # From the base to the gripper
    hand: int  # The last body they move
    end: str  # Why they end there


def find_chain(data: mujoco.MjData, root: int) -> tuple[JointChain, list[int]]:
    """Return the arm that hangs on a body, or is it, and the bodies at which other arms begin."""
    model = data.model
    joints = _arm_joints(model, root)
    others: list[int] = []
    body = root
    hand = root
    while True:
        branches = _moving_parts(model, body)
        free = [b for b in branches if not _is_gripper(model, b)]
        free.sort(key=lambda b: -_joint_count(model, b))
        arms = [b for b in free if _joint_count(model, b) >= ARM_JOINTS]
        longest = max((_length(data, b) for b in arms), default=0.0)
        if len(branches) > 1 and longest > ARM_SHARE * _carried(data, joints, body):
            joints = []  # of a base, lift or waist that carries several parts
            others += arms[1:]
        # Several branches at the end are fingers; below, the one with the most joints is the arm.
        elif len(branches) > 1 and len(joints) >= FIRST_FINGER:
            end = f"{len(branches)} moving parts begin"
            break
        if not free:
            end = "a joint is named as a gripper's" if branches else "the chain ends"
            break
        if len(joints) >= FIRST_FINGER:
            end = _finger(data, free[0])
            if end:
                break
        body = free[0]
        added = _arm_joints(model, body)
        joints += added
        if added:
            hand = body
    joints = _without_base(data, joints)
    if joints and model.body(body).name:
        hand = body  # fixed bodies between the last joint and the fingers carry them
    return JointChain(joints, hand, end), others


def follow_joints(model: mujoco.MjModel, names: Sequence[str]) -> JointChain:
    """Return the chain of joints that are given by name."""
    known = {model.joint(j).name: j for j in range(model.njnt)}
    for name in names:
        if name not in known:
            raise unknown_name("joint", name, known)
    joints = [known[name] for name in names]
    body = int(model.jnt_bodyid[joints[-1]])
    while True:
        parts = _moving_parts(model, body)
        if len(parts) != 1 or model.body_jntnum[parts[0]]:
            return JointChain(joints, body, "the given joints end")
        body = parts[0]


def _moving_parts(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the bodies that hang on a body and have joints, or carry bodies that have."""
    children = np.flatnonzero(model.body_parentid == body)
    return [b for b in children.tolist() if b and _joint_count(model, b)]


def _joint_count(model: mujoco.MjModel, body: int) -> int:
    """Return the number of joints of a body and all that hang on it."""
    return len(joints_of(model, subtree(model, body)))


def _is_gripper(model: mujoco.MjModel, body: int) -> bool:
    """Return whether a joint of a body is named as a gripper's."""
    return any(
        GRIPPER_WORDS.search(model.joint(j).name) for j in joints_of(model, [body])
    )


def _arm_joints(model: mujoco.MjModel, body: int) -> list[int]:
    """Return those of a body's joints that can be an arm's."""
    joints = joints_of(model, [body])
    return [j for j in joints if model.jnt_type[j] in _MOVABLE and model.joint(j).name]


def _without_base(data: mujoco.MjData, joints: list[int]) -> list[int]:
    """Leave out the slides of a mobile base, rail or lift before an arm of hinges."""
    slides = [is_slide(data.model, j) for j in joints]
    if all(slides):
        return joints
    first = slides.index(False)
    if first >= 2 and abs(data.xaxis[joints[first]][2]) > 0.99:
        first += 1  # a base that drives in the plane also turns
    return joints[first:] if slides[first:].count(False) > ARM_JOINTS else joints


def _length(data: mujoco.MjData, body: int) -> float:
    """Return the distance from a body to the farthest of those that hang on it [m]."""
    inside = subtree(data.model, body)
    return float(np.linalg.norm(data.xpos[inside] - data.xpos[body], axis=1).max())


def _carried(data: mujoco.MjData, joints: list[int], body: int) -> float:
    """Return the length of the chain of joints up to a body [m]; 0 if there are none."""
    return polyline_m([*data.xanchor[joints], data.xpos[body]])


def _finger(data: mujoco.MjData, body: int) -> str:
    """Return by what a body is known as a finger: a coupling, a site before it, a fixed jaw; or ''.

    The body is the only one that moves where it hangs.
    """
    model = data.model
    inside = subtree(model, body)
    for group in couplings(model):
        bodies = model.jnt_bodyid[group].tolist()
        others = [
            b for b in bodies if b not in inside and body not in subtree(model, b)
        ]
        if others and body in bodies:
            return (
                f"joints of several parts are coupled ({joint_name(model, group[0])!r})"
            )
    joints = joints_of(model, inside)
    if len(joints) > 1:
        return ""
    before = fixed_to(model, int(model.body_parentid[body]))
    sites = tool_sites(model, before)
    if sites:
        return f"site {model.site(min(sites)).name!r} lies before the last joint"
    if not joints:
        return ""
    joint = joints[0]
    is_short = (
        model.jnt_limited[joint] and np.ptp(model.jnt_range[joint]) < JAW_TRAVEL_M
    )
    if is_slide(model, joint) and is_short:
        return f"the last part slides by less than {JAW_TRAVEL_M} m"
    is_jaw = _is_jaw(data, joint, geoms_of(model, inside), geoms_of(model, before))
    return "a jaw moves beside a fixed part" if is_jaw else ""


def _is_jaw(data: mujoco.MjData, joint: int, moving: Integers, fixed: Integers) -> bool:
    """Return whether geoms that a joint moves reach to one side, and fixed ones beside them."""
    if not len(moving) or not len(fixed):
        return False
    anchor = data.xanchor[joint]
    out = data.geom_xpos[moving].mean(axis=0) - anchor
    length = float(np.linalg.norm(out))
    if length < 1e-6 or abs(data.xaxis[joint] @ out) > 0.3 * length:
        return False  # a wrist that rolls
    direction = out / length
    far = extent(data, moving, direction, anchor)
    back = extent(data, moving, -direction, anchor)
    beside = extent(data, fixed, direction, anchor)
    return beside > JAW_SHARE * far and back < JAW_SHARE * far


def fixed_to(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the ids of a body and of those that no joint separates from it."""
    return np.flatnonzero(model.body_weldid == model.body_weldid[body]).tolist()


def subtree(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the ids of a body and all that hang on it."""
    inside = [body]
    for b in range(body + 1, model.nbody):
        if model.body_parentid[b] in inside:
            inside.append(b)
    return inside


def joints_of(model: mujoco.MjModel, bodies: Sequence[int]) -> list[int]:
    """Return the ids of the joints of bodies."""
    return np.flatnonzero(np.isin(model.jnt_bodyid, bodies)).tolist()


def geoms_of(model: mujoco.MjModel, bodies: Sequence[int]) -> Integers:
    """Return the ids of the geoms of bodies."""
    return np.flatnonzero(np.isin(model.geom_bodyid, bodies))


def tool_sites(model: mujoco.MjModel, bodies: Sequence[int]) -> list[int]:
    """Return the sites of bodies that are named as a tool centre point, best first."""
    ranks = {}
    for site in np.flatnonzero(np.isin(model.site_bodyid, bodies)).tolist():
        name = model.site(site).name.lower()
        words = [i for i, word in enumerate(SITE_WORDS) if word in name]
        if words:
            ranks[site] = words[0]
    return sorted(ranks, key=ranks.__getitem__)


def is_slide(model: mujoco.MjModel, joint: int) -> bool:
    """Return whether a joint slides."""
    return bool(model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE)


def polyline_m(points: Sequence[Floats] | Floats) -> float:
    """Return the length of the line through points (n, 3) [m]."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def extent(
    data: mujoco.MjData, geoms: Integers, direction: Floats, origin: Floats
) -> float:
    """Return how far geoms reach from a point in a direction [m]."""
    middle, half = np.split(data.model.geom_aabb[geoms], 2, axis=1)
    local = direction @ data.geom_xmat[geoms].reshape(-1, 3, 3)
    ends = (data.geom_xpos[geoms] - origin) @ direction
    ends += (local * middle).sum(axis=1) + (np.abs(local) * half).sum(axis=1)
    return float(ends.max(initial=-np.inf))


def joint_name(model: mujoco.MjModel, joint: int) -> str:
    """Return a joint's name, or its kind and body if it has none."""
    kind = mujoco.mjtJoint(model.jnt_type[joint]).name.removeprefix("mjJNT_").lower()
    body = model.body(model.jnt_bodyid[joint]).name
    return model.joint(joint).name or f"unnamed {kind} joint of body {body!r}"


def couplings(model: mujoco.MjModel) -> list[list[int]]:
    """Return the joints that move together, by joint equality or fixed tendon."""
    equalities = np.flatnonzero(model.eq_type == mujoco.mjtEq.mjEQ_JOINT)
    groups = np.column_stack([model.eq_obj1id, model.eq_obj2id])[equalities].tolist()
    for first, count in zip(model.tendon_adr, model.tendon_num, strict=True):
        wraps = slice(first, first + count)
        is_joint = model.wrap_type[wraps] == mujoco.mjtWrap.mjWRAP_JOINT
        groups.append(model.wrap_objid[wraps][is_joint].tolist())
    return [group for group in groups if len(group) > 1 and min(group) >= 0]
