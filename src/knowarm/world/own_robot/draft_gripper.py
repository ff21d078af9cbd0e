"""Arm and gripper of a bare MJCF file: the joints that the agent moves, and the TCP."""

import re
from dataclasses import dataclass

import mujoco
import numpy as np

from knowarm.arrays import Floats, Integers
from knowarm.errors import UserError

GRIPPER_WORDS = re.compile(r"grip|finger|jaw|knuckle|driver|claw|thumb", re.IGNORECASE)
"""Joints with these words in their name open the gripper."""

SITE_WORDS = ("tcp", "pinch", "grasp", "grip", "ee", "end", "tool", "attach", "flange")
"""Sites at the tool centre point have one of these words in their name, best first."""

AGREEING_COSINE = 0.7  # From this cosine on a site's z axis counts as the approach direction
FIRST_FINGER = 3  # A joint is taken for a finger's after at least so many joints of the arm
JAW_SHARE = 0.5  # A fixed part that reaches at least so far along a moving one is its other jaw
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
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    joints, hand, end = _chain(model, data)
    if len(joints) < 2:
        raise UserError(
            "The file has no chain of at least two named hinge or slide joints; an arm needs them. "
            "Name its joints, or list them in the description's field joints."
        )
    inside = _subtree(model, hand)
    outer = [b for b in inside if b != hand and model.body_jntnum[b] > 0]
    sites = sorted(
        (_site_rank(model.site(s).name), s)
        for s in range(model.nsite)
        if model.site_bodyid[s] in inside and model.site(s).name
    )
    names = tuple(model.joint(j).name for j in joints)
    left = [joint_name(model, j) for j in range(model.njnt) if j not in joints]
    count = (
        f"{len(names)} joints up to body {model.body(hand).name!r}, where {end}: "
        f"{', '.join(names)}; left out: {', '.join(left) or 'none'}"
    )
    approach, tip = _approach(model, data, joints[-1], hand, outer)
    across = _across(model, data, outer, approach)
    rank, site = sites[0] if sites else (len(SITE_WORDS), -1)
    if rank < len(SITE_WORDS):
        name = model.site(site).name
        own = data.site_xmat[site].reshape(3, 3)
        if own[:, 2] @ approach > AGREEING_COSINE and abs(own[:, 1] @ across) > AGREEING_COSINE:
            return Gripper(joints=names, tcp={"tcp_site": name}, how=f"{count}; TCP: site {name!r}")
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
    tcp = {
        "tcp_site": next(name for name in ("tcp", "knowarm_tcp", "tcp_") if name not in taken),
        "tcp_body": model.body(hand).name,
        "tcp_position_m": tuple(np.round(rotation.T @ (point - data.xpos[hand]), 5).tolist()),
        "tcp_quaternion": tuple(np.round(quaternion, 6).tolist()),
    }
    return Gripper(joints=names, tcp=tcp, how=f"{count}; TCP: {source}")


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


def _chain(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[list[int], int, str]:
    """Return the joints from the base to the gripper, the last body they move, and why there."""
    moved = [[j for j in range(model.njnt) if model.jnt_bodyid[j] == b] for b in range(model.nbody)]
    amount = [sum(len(moved[b]) for b in _subtree(model, body)) for body in range(model.nbody)]
    joints: list[int] = []
    body, hand = 0, 0
    while True:
        branches = [
            b for b in range(1, model.nbody) if model.body_parentid[b] == body and amount[b]
        ]
        named = [
            b for b in branches if any(GRIPPER_WORDS.search(model.joint(j).name) for j in moved[b])
        ]
        # Several branches at the end are fingers; below, the one with the most joints is the arm.
        if len(branches) > 1 and len(joints) >= FIRST_FINGER:
            end = f"{len(branches)} moving parts begin"
            break
        if len(branches) == len(named):
            end = "a joint is named as a gripper's" if branches else "the chain ends"
            break
        following = max(set(branches) - set(named), key=lambda b: amount[b])
        if len(joints) >= FIRST_FINGER and (finger := _finger(model, data, following)):
            end = finger
            break
        body = following
        own = [j for j in moved[body] if model.jnt_type[j] in _MOVABLE and model.joint(j).name]
        joints += own
        hand = body if own else hand
    # Fixed bodies between the last joint and the fingers carry them.
    return joints, body if joints and model.body(body).name else hand, end


def _finger(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> str:
    """Return by what a body is known as a finger: a coupling, a site before it, a fixed jaw; or ''.

    The body is the only one that moves where it hangs.
    """
    inside = _subtree(model, body)
    for group in couplings(model):
        bodies = {int(model.jnt_bodyid[j]) for j in group}
        others = [b for b in bodies if b not in inside and body not in _subtree(model, b)]
        if others and body in bodies:
            return f"joints of several parts are coupled ({joint_name(model, group[0])!r})"
    own = [j for j in range(model.njnt) if model.jnt_bodyid[j] in inside]
    if len(own) > 1:
        return ""
    before = _fixed_to(model, int(model.body_parentid[body]))
    for s in range(model.nsite):
        name = model.site(s).name
        if model.site_bodyid[s] in before and _site_rank(name) < len(SITE_WORDS):
            return f"site {name!r} lies before the last joint"
    moving, fixed = (np.flatnonzero(np.isin(model.geom_bodyid, each)) for each in (inside, before))
    if not len(own) or not len(moving) or not len(fixed):
        return ""
    anchor = data.xanchor[own[0]]
    out = data.geom_xpos[moving].mean(axis=0) - anchor
    length = float(np.linalg.norm(out))
    if length < 1e-6 or abs(data.xaxis[own[0]] @ out) > 0.3 * length:
        return ""  # a wrist that rolls
    far = _extent(model, data, moving, out / length, anchor)
    back = _extent(model, data, moving, -out / length, anchor)
    beside = _extent(model, data, fixed, out / length, anchor)
    jaw = beside > JAW_SHARE * far and back < JAW_SHARE * far
    return "a jaw moves beside a fixed part" if jaw else ""


def _fixed_to(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the ids of a body and of those that no joint separates from it."""
    return np.flatnonzero(model.body_weldid == model.body_weldid[body]).tolist()


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
    end = max(end, _extent(model, data, geoms, approach, np.zeros(3)))
    # Fingers grasp a little before their ends.
    end -= 0.1 * (end - float(origin @ approach)) if fingers else 0.0
    middle = centres.mean(axis=0) if fingers else origin
    if len(fingers) == 1 and len(geoms):
        start = float(data.xpos[fingers[0]] @ approach)
        fixed = np.flatnonzero(np.isin(model.geom_bodyid, _fixed_to(model, hand)))
        ends = [_extent(model, data, np.array([g]), approach, np.zeros(3)) for g in fixed]
        other = fixed[np.array(ends) > start + JAW_SHARE * (end - start)]
        if len(other):  # between the moving jaw and the fixed one
            middle = (middle + data.geom_xpos[other].mean(axis=0)) / 2
    return approach, middle + approach * (end - float(middle @ approach))


def _extent(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Integers, direction: Floats, origin: Floats
) -> float:
    """Return how far geoms reach from a point in a direction [m]."""
    rotation = data.geom_xmat[geoms].reshape(-1, 3, 3)
    middle, half = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
    local = direction @ rotation
    ends = (data.geom_xpos[geoms] - origin) @ direction
    ends += (local * middle).sum(axis=1) + (np.abs(local) * half).sum(axis=1)
    return float(ends.max(initial=-np.inf))


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
