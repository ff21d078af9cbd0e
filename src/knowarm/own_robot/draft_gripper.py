"""Arm and gripper of a bare MJCF file: the joints that the agent moves, and the TCP."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mujoco import MjData, MjModel, mj_kinematics, mj_name2id, mjtObj, mju_mat2Quat
from numpy.linalg import norm

from knowarm.arrays import Floats, Integers
from knowarm.errors import UserError
from knowarm.own_robot.draft_chain import (
    JAW_SHARE,
    Ids,
    box_corners,
    extent,
    find_chain,
    fixed_to,
    follow_joints,
    is_slide,
    joint_name,
    joint_names,
    joints_of,
    subtree,
    tool_sites,
)
from knowarm.own_robot.opening import (
    LEAST_M,
    MOST_DRIVERS,
    MOST_M,
    SAME_M,
    Motion,
    Opening,
    widest_opening,
)
from knowarm.own_robot.poses import Fields
from knowarm.world.scene.surface import geoms_of, solid_geoms

AGREEING_COSINE = 0.7
"""From this cosine on a site's z axis counts as the approach direction."""

FRAMED_COSINE = 0.999  # Of a joint's axis that is one of a frame's
NEAR_COSINE = 0.9  # Of an approach that is meant to be one

TOOL_M = 0.05
"""Distance of the tool centre point in front of an arm that ends at its flange [m]."""


ASIDE_M = 0.03  # Farthest from the middle between fingers that a tool frame lies aside
AHEAD_M = 0.06  # Farthest beyond their ends
BEFORE = 0.1  # Share of a hand's length that the TCP lies before the fingers' ends
FINGERTIP_M = 0.01  # Parts that end nearer to a finger's end are fingers too
SUCTION = "it holds by suction"
STILL = {
    "suction|vacuum": SUCTION,
    "grip|finger|jaw|claw": "its gripper has no joints in the file",
}
"""Why a hand without joints has no fingers, by words in the names of its bodies."""

BEHIND_M = 0.01  # Farthest behind their beginning

_HORIZONTAL = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
"""Directions across a hand that has no fingers to tell it by, the first that is not along it."""


@dataclass(frozen=True, kw_only=True)
class Gripper:
    """What was found of the arm and its tool centre point (TCP)."""

    joints: tuple[str, ...]  # Names of the arm's joints, base to tip
    fields: Fields  # ``tcp_...``, ``fingers``, ``held_joints``
    how: str  # How the joints and the TCP were chosen


def find_gripper(model: MjModel, given: Sequence[str] = ()) -> Gripper:
    """Find the arm's joints along the kinematic chain, and the TCP at its end.

    ``given`` are the joints of the arm where the file has several, base to tip.
    """
    data = MjData(model)
    mj_kinematics(model, data)
    others: Ids = []
    if given:
        chain = follow_joints(model, given)
    else:
        chain, others = find_chain(data, 0)
    if len(chain.joints) < 2:
        raise UserError(
            "The file has no chain of at least two named hinge or slide joints; an arm needs them. "
            "Name its joints, or list them in the description's field joints."
        )
    names = joint_names(model, chain.joints)
    left = [joint_name(model, j) for j in range(model.njnt) if j not in chain.joints]
    how = (
        f"{len(names)} joints up to body {model.body(chain.hand).name!r}, where {chain.end}: "
        f"{', '.join(names)}; left out: {', '.join(left) or 'none'}"
    )
    for other in others:
        arm, _ = find_chain(data, other)
        how += f"; another arm: joints = {json.dumps(joint_names(model, arm.joints))}"
    fields, source = _tcp_fields(data, chain.joints[-1], chain.hand)
    return Gripper(joints=tuple(names), fields=fields, how=f"{how}; TCP: {source}")


def _tcp_fields(data: MjData, last: int, hand: int) -> tuple[Fields, str]:
    """Return the fields of TCP and fingers of a hand after the last joint, and their source."""
    model = data.model
    inside = subtree(model, hand)
    outer = [b for b in inside[1:] if model.body_jntnum[b]]  # the first is the hand
    approach, point = _approach(data, last, hand, outer)
    motion = Motion(data, joints_of(model, outer))
    groups = _rigid_groups(data, outer)
    reach = np.array([extent(data, np.array(geoms), approach) for geoms in groups])
    across = _across(data, outer, approach, _farthest_way(motion.shifts(groups), reach))
    frame = np.stack([np.cross(across, approach), across, approach], axis=1)
    fingers: Fields = {}
    opening = None
    try:
        if outer:
            opening = _open_fingers(motion, groups, reach, frame)
            names = [model.body(body).name for body in opening.bodies]
            fingers = {"fingers": names, "held_joints": opening.joints}
            text = f"; fingers: {' and '.join(names)}, open by {100 * opening.gap_m:.1f} cm"
            point = opening.tip
        else:
            text = _still(model, inside)
    except UserError as error:
        text = f"; no fingers: {error}"
    if text and SUCTION not in text:  # fingers grasp a little before their ends
        ahead = (point - data.xanchor[last]) @ approach
        point = point - BEFORE * ahead * approach
    bodies = inside
    if outer:
        bodies = fixed_to(model, [hand])
    sites = tool_sites(model, bodies)
    if outer:
        geoms = geoms_of(model, fixed_to(model, outer))
        kept = [s for s in sites if _is_between(data, s, point, approach, geoms)]
    else:  # a tool may stand aside, such as a dummy's frame beside that of the flange
        kept = sorted(
            sites, key=lambda s: _ahead_aside(data, s, point, approach)[1] >= ASIDE_M
        )
    if kept:
        site = kept[0]
        name = model.site(site).name
        back = 0.0
        if opening and (data.site_xpos[site] - opening.tip) @ approach > 0:
            back = opening.retreat_m
        _, y, z = data.site_xmat[site].reshape(3, 3).T
        cosine = min(z @ approach, abs(y @ across))
        if cosine > AGREEING_COSINE and back < SAME_M:
            return {"tcp_site": name, **fingers}, f"site {name!r}{text}"
        point = data.site_xpos[site] - back * approach
        source = f"the place of site {name!r}, turned"
        if back > SAME_M:
            source = f"{100 * back:.1f} cm before site {name!r}, as open fingers end before closed"
    elif outer:
        source = "between the ends of the gripper's fingers"
        if sites:
            elsewhere = ", ".join(repr(model.site(s).name) for s in sites)
            source += f", where {elsewhere} is not"
    elif text:  # a tool that does not move
        source = "at the end of the gripper"
    else:
        point = point + TOOL_M * approach
        source = f"{TOOL_M} m in front of the last body"
    to_hand = data.xmat[hand].reshape(3, 3).T
    quaternion = np.zeros(4)
    mju_mat2Quat(quaternion, (to_hand @ frame).ravel())
    position = to_hand @ (point - data.xpos[hand])
    site_name = "tcp"
    if mj_name2id(model, mjtObj.mjOBJ_SITE, site_name) >= 0:
        site_name = "knowarm_tcp"
    fields = {
        "tcp_site": site_name,
        "tcp_body": model.body(hand).name,
        "tcp_position_m": tuple(position.round(5).tolist()),
        "tcp_quaternion": tuple(quaternion.round(6).tolist()),
    }
    return fields | fingers, f"{source}{text}"


def _ahead_aside(
    data: MjData, site: int, point: Floats, approach: Floats
) -> tuple[float, float]:
    """Return how far a site lies ahead of a point along the approach, and beside that line [m]."""
    way = data.site_xpos[site] - point
    ahead = way @ approach
    return float(ahead), float(norm(way - ahead * approach))


def _is_between(
    data: MjData, site: int, point: Floats, approach: Floats, fingers: Integers
) -> bool:
    """Return whether a site lies where fingers grasp: near a point between them, or before it."""
    ahead, aside = _ahead_aside(data, site, point, approach)
    if aside >= ASIDE_M:
        return False
    length = point @ approach + extent(data, fingers, -approach)
    return bool(-length - BEHIND_M < ahead < AHEAD_M)


def _rigid_groups(data: MjData, moving: Ids) -> list[Ids]:
    """Return the geoms of what moves, together where no joint separates them."""
    groups = []
    for body in np.unique(data.model.body_weldid[moving]).tolist():
        geoms = solid_geoms(data.model, fixed_to(data.model, [body]))
        if geoms:
            groups.append(geoms)
    return groups


def _farthest_way(shifts: Floats, reach: Floats) -> Floats:
    """Return how a gripper moves what reaches farthest of what it moves, (3,) [m], or zeros.

    ``shifts`` (drivers, groups, 3) are the ways of groups of geoms, which reach out by ``reach``.
    """
    lengths = norm(shifts, axis=2).max(axis=0, initial=0.0)
    if not (lengths > SAME_M).any():
        return np.zeros(3)
    ways = shifts[:, np.where(lengths > SAME_M, reach, -np.inf).argmax()]
    return ways[norm(ways, axis=1).argmax()]


def _open_fingers(
    motion: Motion, groups: Sequence[Ids], reach: Floats, frame: Floats
) -> Opening:
    """Return how two fingers are open, of the groups of geoms that reach farthest on each side.

    The columns of ``frame`` (3, 3) are any direction, that across the hand and the approach.

    Raises:
        UserError: there are no two fingers, for the reason that it names.
    """
    model = motion.data.model
    shifts = motion.shifts(groups) @ frame[:, 1]
    sides: dict[tuple[int, bool], Ids] = {}  # Groups by what drives them, to which side
    for k in np.argsort(-reach).tolist() if motion.drivers else ():
        driver = np.abs(shifts[:, k]).argmax()
        way = shifts[driver, k]
        if abs(way) > SAME_M:
            sides.setdefault((int(driver), way > 0), []).append(k)
    pair = sorted(members[0] for members in [*sides.values()][:2])
    if not pair:
        names = ", ".join(joint_names(model, motion.joints))
        raise UserError(f"{names} have no range with two ends across the hand")
    fingers = [groups[k] for k in pair]
    drivers = motion.drivers_of(fingers)
    names = ", ".join(joint_names(model, drivers))
    if len(pair) < 2:
        alone = model.body(model.geom_bodyid[fingers[0][0]]).name
        raise UserError(
            f"{alone} moves alone across the hand, and drafts take two that do; where a fixed jaw "
            "faces it, set fingers to both, it first, and finger_shares = [1, 0]"
        )
    if len(drivers) > MOST_DRIVERS:
        raise UserError(
            f"{len(drivers)} joints move them that the file couples by no mimic or equality, as a "
            f"URDF has no closed loops: {names}"
        )
    is_end = reach > reach[pair].min() - FINGERTIP_M
    is_moved = (np.abs(shifts) > SAME_M).any(axis=0)
    ends = np.flatnonzero(is_end & is_moved).tolist()
    count = len({motion.root(groups[k]) for k in ends})
    if count > 2:
        raise UserError(f"{count} of them close, and a grip is of two")
    opening = widest_opening(motion, drivers, fingers, frame)
    if opening is None:
        raise UserError(f"{names} reach no end, as loops do not close")
    bodies = [model.body(body).name for body in opening.bodies]
    both = " and ".join(bodies)
    if not all(bodies):
        raise UserError("their bodies have no names")
    if opening.gap_m < LEAST_M:
        raise UserError(f"{both} overlap at all their ends")
    if opening.gap_m > MOST_M:
        open_cm = f"{100 * opening.gap_m:.1f} cm"
        raise UserError(f"{both} open by {open_cm}, as no gripper does")
    return opening


def _still(model: MjModel, bodies: Ids) -> str:
    """Return why a hand on which nothing moves has no fingers; '' for a bare flange."""
    names = " ".join(model.body(body).name for body in bodies)
    for words, reason in STILL.items():
        if re.search(words, names, re.IGNORECASE):
            return f"; no fingers: {reason}"
    return ""


def _approach(
    data: MjData, last: int, hand: int, fingers: Ids
) -> tuple[Floats, Floats]:
    """Return the direction out of the hand, world, and the point where hand or fingers end."""
    model = data.model
    origin = data.xanchor[last]
    axis = data.xaxis[last].copy()
    bodies = fixed_to(model, fingers) or subtree(model, hand)
    geoms = geoms_of(model, bodies)
    centres = data.xpos[bodies]
    if len(geoms):
        centres = data.geom_xpos[geoms]
    middle = centres.mean(axis=0)
    out = middle - origin
    if not fingers:
        # The mesh of a flange may extend backward; what it carries continues the wrist.
        wrist = model.body_parentid[model.jnt_bodyid[last]]
        out += data.xpos[bodies[-1]] - data.xpos[wrist]
    if norm(out) < 1e-6:
        out = axis
    # The last joint mostly turns the hand about the approach; a wrist's hinge lies across it.
    approach = out / norm(out)
    along = axis @ approach
    if abs(along) > 0.3:
        approach = axis * np.sign(along)
    else:
        approach = _squared(approach, axis, data.xmat[hand].reshape(3, 3))
    along_centres = centres @ approach
    end = max(along_centres.max(), extent(data, geoms, approach))
    if not fingers:
        middle = origin
    if len(fingers) == 1 and len(geoms):
        start = data.xpos[fingers[0]] @ approach
        fixed = geoms_of(model, fixed_to(model, [hand]))
        ends = (box_corners(data, fixed) @ approach).max(axis=1)
        least = start + JAW_SHARE * (end - start)
        jaw = fixed[ends > least]
        if len(jaw):  # between the moving jaw and the fixed one
            centre = data.geom_xpos[jaw].mean(axis=0)
            middle = (middle + centre) / 2
    return approach, middle + approach * (end - middle @ approach)


def _squared(approach: Floats, axis: Floats, frame: Floats) -> Floats:
    """Return the axis of a hand's frame (3, 3) near its approach, if the last joint's is one too.

    A hand that is mounted beside the wrist still points as its frame does.
    """
    shares = approach @ frame
    nearest = np.abs(shares).argmax()
    is_framed = np.abs(axis @ frame).max() > FRAMED_COSINE
    if is_framed and abs(shares[nearest]) > NEAR_COSINE:
        return frame[:, nearest] * np.sign(shares[nearest])
    return approach


def _across(data: MjData, moving: Ids, approach: Floats, way: Floats) -> Floats:
    """Return the direction in which a hand opens, world: that of a way, else of what moves.

    It points from the first to the second of what moves, or as a joint of it.
    """
    between = data.xpos[moving[1:]] - data.xpos[moving[:1]]
    joints = joints_of(data.model, moving)
    slides = [j for j in joints if is_slide(data.model, j)]
    swept = np.cross(data.xaxis[joints[:1]], approach)  # by a jaw that turns
    candidates = np.vstack([between, data.xaxis[slides], swept, _HORIZONTAL])
    usual = _first_across(candidates, approach)
    across = _first_across(np.vstack([way, candidates]), approach)
    return across if across @ usual >= 0 else -across


def _first_across(candidates: Floats, approach: Floats) -> Floats:
    """Return the first of directions (n, 3) that is not along an approach, across it."""
    flat = candidates - np.outer(candidates @ approach, approach)
    lengths = norm(flat, axis=1)
    is_across = lengths > 0.3 * norm(candidates, axis=1)
    first = is_across.argmax()
    return flat[first] / lengths[first]
