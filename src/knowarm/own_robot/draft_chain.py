"""Arm of a model: the kinematic chain that ends where fingers begin."""

import re
from collections.abc import Sequence

import mujoco
import numpy as np

from knowarm.arrays import Floats, Integers
from knowarm.errors import unknown_name

GRIPPER_WORDS = re.compile(r"grip|finger|jaw|knuckle|driver|claw|thumb", re.IGNORECASE)
"""Joints with these words in their name open the gripper."""

SITE_WORDS = ("tcp", "pinch", "grasp", "grip", "ee", "end", "tool", "attach", "flange")
"""Sites at the tool centre point have one of these words in their name, best first."""

FIRST_FINGER = 3  # A joint is taken for a finger's after at least so many joints of the arm
ARM_JOINTS = 4  # Several moving parts, of which one has at least so many joints, may be arms
ARM_SHARE = 0.5  # Arms are at least so long, relative to what carries them; fingers are shorter
JAW_SHARE = 0.5  # A fixed part that reaches at least so far along a moving one is its other jaw
JAW_TRAVEL_M = 0.1  # The last part of an arm slides farther than a jaw
_MOVABLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))

Chain = tuple[list[int], int, str]
"""Joints from the base to the gripper, the last body they move, and why they end there."""


def find_chain(model: mujoco.MjModel, data: mujoco.MjData, root: int) -> tuple[Chain, list[int]]:
    """Return the arm that hangs on a body, or is it, and the bodies at which other arms begin."""
    moved = [[j for j in range(model.njnt) if model.jnt_bodyid[j] == b] for b in range(model.nbody)]
    amount = [sum(len(moved[b]) for b in subtree(model, body)) for body in range(model.nbody)]
    joints = _own_joints(model, moved[root])
    others: list[int] = []
    body, hand = root, root
    while True:
        branches = [
            b for b in range(1, model.nbody) if model.body_parentid[b] == body and amount[b]
        ]
        named = [
            b for b in branches if any(GRIPPER_WORDS.search(model.joint(j).name) for j in moved[b])
        ]
        free = sorted((b for b in branches if b not in named), key=lambda b: -amount[b])
        arms = [b for b in free if amount[b] >= ARM_JOINTS]
        longest = max((_length(model, data, b) for b in arms), default=0.0)
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
        if len(joints) >= FIRST_FINGER and (finger := _finger(model, data, free[0])):
            end = finger
            break
        body = free[0]
        own = _own_joints(model, moved[body])
        joints += own
        hand = body if own else hand
    joints = _without_base(model, data, joints)
    # Fixed bodies between the last joint and the fingers carry them.
    return (joints, body if joints and model.body(body).name else hand, end), others


def _own_joints(model: mujoco.MjModel, joints: list[int]) -> list[int]:
    """Return those of a body's joints that can be an arm's."""
    return [j for j in joints if model.jnt_type[j] in _MOVABLE and model.joint(j).name]


def _without_base(model: mujoco.MjModel, data: mujoco.MjData, joints: list[int]) -> list[int]:
    """Leave out the slides of a mobile base, rail or lift before an arm of hinges."""
    slide = mujoco.mjtJoint.mjJNT_SLIDE
    first = next((i for i, j in enumerate(joints) if model.jnt_type[j] != slide), len(joints))
    if first >= 2 and first < len(joints) and abs(data.xaxis[joints[first]][2]) > 0.99:
        first += 1  # a base that drives in the plane also turns
    hinges = [j for j in joints[first:] if model.jnt_type[j] != slide]
    return joints[first:] if len(hinges) > ARM_JOINTS else joints


def follow_joints(model: mujoco.MjModel, names: Sequence[str]) -> Chain:
    """Return the chain of joints that are given by name."""
    known = {model.joint(j).name: j for j in range(model.njnt)}
    for name in names:
        if name not in known:
            raise unknown_name("joint", name, known)
    joints = [known[name] for name in names]
    body = int(model.jnt_bodyid[joints[-1]])
    while True:
        moving = [
            b
            for b in range(1, model.nbody)
            if model.body_parentid[b] == body
            and any(model.body_jntnum[each] for each in subtree(model, b))
        ]
        if len(moving) != 1 or model.body_jntnum[moving[0]]:
            return joints, body, "the given joints end"
        body = moving[0]


def _length(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> float:
    """Return the distance from a body to the farthest of those that hang on it [m]."""
    inside = subtree(model, body)
    return float(np.linalg.norm(data.xpos[inside] - data.xpos[body], axis=1).max())


def _carried(data: mujoco.MjData, joints: list[int], body: int) -> float:
    """Return the length of the chain of joints up to a body [m]; 0 if there are none."""
    points = [*data.xanchor[joints], data.xpos[body]]
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _finger(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> str:
    """Return by what a body is known as a finger: a coupling, a site before it, a fixed jaw; or ''.

    The body is the only one that moves where it hangs.
    """
    inside = subtree(model, body)
    for group in couplings(model):
        bodies = {int(model.jnt_bodyid[j]) for j in group}
        others = [b for b in bodies if b not in inside and body not in subtree(model, b)]
        if others and body in bodies:
            return f"joints of several parts are coupled ({joint_name(model, group[0])!r})"
    own = [j for j in range(model.njnt) if model.jnt_bodyid[j] in inside]
    if len(own) > 1:
        return ""
    before = fixed_to(model, int(model.body_parentid[body]))
    for s in range(model.nsite):
        name = model.site(s).name
        if model.site_bodyid[s] in before and site_rank(name) < len(SITE_WORDS):
            return f"site {name!r} lies before the last joint"
    slides = bool(own) and model.jnt_type[own[0]] == mujoco.mjtJoint.mjJNT_SLIDE
    if slides and model.jnt_limited[own[0]] and np.ptp(model.jnt_range[own[0]]) < JAW_TRAVEL_M:
        return f"the last part slides by less than {JAW_TRAVEL_M} m"
    moving, fixed = (np.flatnonzero(np.isin(model.geom_bodyid, each)) for each in (inside, before))
    if not len(own) or not len(moving) or not len(fixed):
        return ""
    anchor = data.xanchor[own[0]]
    out = data.geom_xpos[moving].mean(axis=0) - anchor
    length = float(np.linalg.norm(out))
    if length < 1e-6 or abs(data.xaxis[own[0]] @ out) > 0.3 * length:
        return ""  # a wrist that rolls
    far = extent(model, data, moving, out / length, anchor)
    back = extent(model, data, moving, -out / length, anchor)
    beside = extent(model, data, fixed, out / length, anchor)
    jaw = beside > JAW_SHARE * far and back < JAW_SHARE * far
    return "a jaw moves beside a fixed part" if jaw else ""


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


def site_rank(name: str) -> int:
    """Return the index of the first word in a site's name, or their number."""
    words = [i for i, word in enumerate(SITE_WORDS) if word in name.lower()]
    return min(words, default=len(SITE_WORDS))


def extent(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Integers, direction: Floats, origin: Floats
) -> float:
    """Return how far geoms reach from a point in a direction [m]."""
    rotation = data.geom_xmat[geoms].reshape(-1, 3, 3)
    middle, half = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
    local = direction @ rotation
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
    groups = [[model.eq_obj1id[e], model.eq_obj2id[e]] for e in equalities]
    for first, count in zip(model.tendon_adr, model.tendon_num, strict=True):
        wraps = range(first, first + count)
        groups.append(
            [
                model.wrap_objid[w]
                for w in wraps
                if model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_JOINT
            ]
        )
    return [[int(j) for j in group] for group in groups if len(group) > 1 and min(group) >= 0]
