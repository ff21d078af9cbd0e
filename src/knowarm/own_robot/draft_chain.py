"""Arm of a model: the kinematic chain that ends where fingers begin."""

import re
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from mujoco import MjData, MjModel, mjtEq, mjtJoint, mjtWrap
from numpy.linalg import norm

from knowarm.arrays import Floats, Integers
from knowarm.errors import unknown_name
from knowarm.world.scene.surface import geoms_of

GRIPPER_WORDS = re.compile(r"grip|finger|jaw|knuckle|driver|claw|thumb", re.IGNORECASE)
"""Joints with these words in their name open the gripper."""

TOOL_WORDS = (
    r"\w*tcp\w*",
    "pinch(ing)?",
    "grasp(ing)?",
    "tool(cent(er|re))?",
    "grip(per|ping)?",
    "eef?|end(ef|eff|effector)?|effector",
    "(finger|tool)?tips?",
    "attach(ment)?",
    "flange",
)
"""Frames at the tool centre point have one of these words in their name, best first."""

OTHER_WORDS = (
    r"led|light|lamp|laser|\w*cam(era)?|optical|depth|rgbd?|lens|projector|\w*sensor|imu|gyro|"
    "accel(erometer)?|ft|force|torque|touch|motor|tag|marker|screw|cable|lidar|scanner|realsense|"
    "tof|aruco|barcode|com|inertial?|mic(rophone)?|proximity|ultrasonic|sonar|vision|collision|"
    "dummy|base|mount|adapt[eo]r|changer|coupler"
)
"""Frames with one of these words in their name are those of something else."""

SUFFIXES = "(?<=.)(frame|site|link|point|pose)$"
"""Endings of words that say only that it is a frame."""

FIRST_FINGER = 3
"""A joint is taken for a finger's after at least so many joints of the arm."""

ARM_JOINTS = 4
"""Several moving parts, of which one has at least so many joints, may be arms."""

ARM_SHARE = 0.5
"""Arms are at least so long, relative to what carries them; fingers are shorter."""

JAW_SHARE = 0.5
"""A fixed part that reaches at least so far along a moving one is its other jaw."""

JAW_TRAVEL_M = 0.1  # The last part of an arm slides farther than a jaw
MOVABLE = (int(mjtJoint.mjJNT_HINGE), int(mjtJoint.mjJNT_SLIDE))

Ids = list[int]
"""Ids of joints, bodies or sites of a model."""


class JointChain(NamedTuple):
    """Joints of an arm."""

    joints: Ids  # From the base to the gripper
    hand: int  # The last body they move
    end: str  # Why they end there


def find_chain(data: MjData, root: int) -> tuple[JointChain, Ids]:
    """Return the arm that hangs on a body, or is it, and the bodies at which other arms begin."""
    model = data.model
    joints = _arm_joints(model, root)
    others: Ids = []
    body = root
    hand = root
    while True:
        branches = _moving_parts(model, body)
        free = [b for b in branches if not _is_gripper(model, b)]
        free.sort(key=lambda b: -_joint_count(model, b))
        arms = []
        longest = 0.0
        for b in free:
            if _joint_count(model, b) < ARM_JOINTS:
                break
            arms.append(b)
            inside = subtree(model, b)
            lengths = norm(data.xpos[inside] - data.xpos[b], axis=1)
            longest = max(longest, lengths.max())
        carried = polyline_m([*data.xanchor[joints], data.xpos[body]])
        if len(branches) > 1 and longest > ARM_SHARE * carried:
            joints = []  # of a base, lift or waist that carries several parts
            others += arms[1:]
        else:
            end = _end(data, len(joints), branches, free)
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


def _end(data: MjData, count: int, branches: Ids, free: Ids) -> str:
    """Return why an arm of so many joints ends before its branches; '' if it goes on.

    ``free`` are the branches that no name tells to be a gripper's, the longest first.
    """
    # Several branches at the end are fingers; below, the one with the most joints is the arm.
    if len(branches) > 1 and count >= FIRST_FINGER:
        return f"{len(branches)} moving parts begin"
    if not branches:
        return "the chain ends"
    if not free:
        return "a joint is named as a gripper's"
    if count < FIRST_FINGER:
        return ""
    return _finger(data, free[0])


def follow_joints(model: MjModel, names: Sequence[str]) -> JointChain:
    """Return the chain of joints that are given by name."""
    known = joint_names(model, range(model.njnt))
    for name in names:
        if name not in known:
            raise unknown_name("joint", name, known)
    joints = list(map(known.index, names))
    body = int(model.jnt_bodyid[joints[-1]])
    parts = _moving_parts(model, body)
    while len(parts) == 1 and not model.body_jntnum[parts[0]]:
        body = parts[0]
        parts = _moving_parts(model, body)
    return JointChain(joints, body, "the given joints end")


def _moving_parts(model: MjModel, body: int) -> Ids:
    """Return the bodies that hang on a body and have joints, or carry bodies that have."""
    children = np.flatnonzero(model.body_parentid == body)
    return [b for b in children.tolist() if b and _joint_count(model, b)]


def _joint_count(model: MjModel, body: int) -> int:
    """Return the number of joints of a body and all that hang on it."""
    return len(joints_of(model, subtree(model, body)))


def _is_gripper(model: MjModel, body: int) -> bool:
    """Return whether a joint of a body is named as a gripper's."""
    names = joint_names(model, joints_of(model, [body]))
    return bool(GRIPPER_WORDS.search(" ".join(names)))


def _arm_joints(model: MjModel, body: int) -> Ids:
    """Return those of a body's joints that can be an arm's."""
    joints = joints_of(model, [body])
    return [j for j in joints if model.jnt_type[j] in MOVABLE and model.joint(j).name]


def _without_base(data: MjData, joints: Ids) -> Ids:
    """Leave out the slides of a mobile base, rail or lift before an arm of hinges."""
    slides = [is_slide(data.model, j) for j in joints]
    if all(slides):
        return joints
    first = slides.index(False)
    if first >= 2 and abs(data.xaxis[joints[first]][2]) > 0.99:
        first += 1  # a base that drives in the plane also turns
    if slides[first:].count(False) > ARM_JOINTS:
        return joints[first:]
    return joints


def _finger(data: MjData, body: int) -> str:
    """Return by what a body is known as a finger: a coupling, a site before it, a fixed jaw; or ''.

    The body is the only one that moves where it hangs.
    """
    model = data.model
    inside = subtree(model, body)
    for group in couplings(model):
        bodies = model.jnt_bodyid[group]
        if body not in bodies:
            continue
        for other in set(bodies).difference(inside):
            if body not in subtree(model, other):
                name = joint_name(model, group[0])
                return f"joints of several parts are coupled ({name!r})"
    joints = joints_of(model, inside)
    if len(joints) > 1:
        return ""
    before = fixed_to(model, [model.body_parentid[body]])
    sites = tool_sites(model, before)
    if sites:
        return f"site {model.site(min(sites)).name!r} lies before the last joint"
    if not joints:
        return ""
    (joint,) = joints
    is_short = np.ptp(model.jnt_range[joint]) < JAW_TRAVEL_M
    if is_slide(model, joint) and model.jnt_limited[joint] and is_short:
        return f"the last part slides by less than {JAW_TRAVEL_M} m"
    if _is_jaw(data, joint, geoms_of(model, inside), geoms_of(model, before)):
        return "a jaw moves beside a fixed part"
    return ""


def _is_jaw(data: MjData, joint: int, moving: Integers, fixed: Integers) -> bool:
    """Return whether geoms that a joint moves reach to one side, and fixed ones beside them."""
    if not len(moving):
        return False
    anchor = data.xanchor[joint]
    out = data.geom_xpos[moving].mean(axis=0) - anchor
    length = norm(out)
    if length < 1e-6:
        return False
    if abs(data.xaxis[joint] @ out) > 0.3 * length:
        return False  # a wrist that rolls
    direction = out / length
    start = anchor @ direction
    far = extent(data, moving, direction) - start
    back = extent(data, moving, -direction) + start
    beside = extent(data, fixed, direction) - start
    least = JAW_SHARE * far
    return bool(back < least < beside)


def fixed_to(model: MjModel, bodies: Sequence[int]) -> Ids:
    """Return the ids of bodies and of those that no joint separates from one."""
    welded = model.body_weldid[list(bodies)]
    return np.flatnonzero(np.isin(model.body_weldid, welded)).tolist()


def subtree(model: MjModel, body: int) -> Ids:
    """Return the ids of a body and all that hang on it."""
    after = np.arange(model.nbody) > body
    ends = np.flatnonzero(after & (model.body_parentid < body))
    return list(range(body, ends.min(initial=model.nbody)))


def joints_of(model: MjModel, bodies: Sequence[int]) -> Ids:
    """Return the ids of the joints of bodies."""
    return np.flatnonzero(np.isin(model.jnt_bodyid, bodies)).tolist()


def tool_sites(model: MjModel, bodies: Sequence[int]) -> Ids:
    """Return the sites of bodies that are named as a tool centre point, best first."""
    texts = {}
    for site in np.flatnonzero(np.isin(model.site_bodyid, bodies)).tolist():
        words = re.findall("[A-Z]?[a-z]+|[A-Z]+(?![a-z])", model.site(site).name)
        text = " ".join(re.sub(SUFFIXES, "", word.lower()) for word in words)
        if not re.search(rf"\b({OTHER_WORDS})\b", text):
            texts[site] = text
    sites: Ids = []
    for pattern in TOOL_WORDS:
        named = re.compile(rf"\b({pattern})\b")
        sites += [site for site, text in texts.items() if named.search(text)]
    return list(dict.fromkeys(sites))


def is_slide(model: MjModel, joint: int) -> bool:
    """Return whether a joint slides."""
    return bool(model.jnt_type[joint] == mjtJoint.mjJNT_SLIDE)


def polyline_m(points: Sequence[Floats] | Floats) -> float:
    """Return the length of the line through points (n, 3) [m]."""
    return float(norm(np.diff(points, axis=0), axis=1).sum())


def box_corners(data: MjData, geoms: Sequence[int] | Integers) -> Floats:
    """Return the corners of boxes around geoms, world, (n, 8, 3) [m]."""
    signs = np.array(list(product((-1, 1), repeat=3)))
    middle, half = np.split(data.model.geom_aabb[geoms, None], 2, axis=-1)
    to_local = data.geom_xmat[geoms].reshape(-1, 3, 3).swapaxes(1, 2)
    corners = (middle + signs * half) @ to_local
    corners += data.geom_xpos[geoms, None]
    return corners


def extent(data: MjData, geoms: Integers, direction: Floats) -> float:
    """Return how far geoms reach in a direction, from the world's origin [m]; -inf if none."""
    along = box_corners(data, geoms) @ direction
    return float(along.max(initial=-np.inf))


def joint_names(model: MjModel, joints: Sequence[int]) -> list[str]:
    """Return the names of joints, '' for those without."""
    return [model.joint(j).name for j in joints]


def joint_name(model: MjModel, joint: int) -> str:
    """Return a joint's name, or its kind and body if it has none."""
    kind = mjtJoint(model.jnt_type[joint]).name.removeprefix("mjJNT_").lower()
    body = model.body(model.jnt_bodyid[joint]).name
    return model.joint(joint).name or f"unnamed {kind} joint of body {body!r}"


def couplings(model: MjModel) -> list[Ids]:
    """Return the joints that move together, by joint equality or fixed tendon."""
    is_equality = model.eq_type == mjtEq.mjEQ_JOINT
    pairs = np.column_stack([model.eq_obj1id, model.eq_obj2id])[is_equality]
    # What a tendon wraps is joints, or none at all.
    is_joint = model.wrap_type == mjtWrap.mjWRAP_JOINT
    wrapped = np.where(is_joint, model.wrap_objid, -1)
    tendons = np.split(wrapped, model.tendon_adr[1:])
    groups = list[Ids]()
    for group in (*pairs, *tendons):
        if len(group) > 1 and group.min() >= 0:
            groups.append(group.tolist())
    return groups
