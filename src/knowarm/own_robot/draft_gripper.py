"""Arm and gripper of a bare MJCF file: the joints that the agent moves, and the TCP."""

import json
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
    geoms_of,
    is_slide,
    joint_name,
    joint_names,
    joints_of,
    subtree,
    tool_sites,
)
from knowarm.own_robot.opening import LEAST_M, MOST_M, SAME_M, widest_opening
from knowarm.own_robot.poses import Fields

AGREEING_COSINE = 0.7
"""From this cosine on a site's z axis counts as the approach direction."""

TOOL_M = 0.05
"""Distance of the tool centre point in front of an arm that ends at its flange [m]."""


ASIDE_M = 0.03  # Farthest from the middle between fingers that a tool frame lies aside
AHEAD_M = 0.06  # Farthest beyond their ends
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
    left = list[str]()
    for j in range(model.njnt):
        if j not in chain.joints:
            left.append(joint_name(model, j))
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
    across = _across(data, outer, approach)
    frame = np.stack([np.cross(across, approach), across, approach], axis=1)
    fingers, text, middle_m = _fingers(data, outer, frame)
    if middle_m is not None:
        point = point + across * (middle_m - across @ point)
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
        _, y, z = data.site_xmat[site].reshape(3, 3).T
        cosine = min(z @ approach, abs(y @ across))
        if cosine > AGREEING_COSINE:
            return {"tcp_site": name, **fingers}, f"site {name!r}{text}"
        point = data.site_xpos[site]
        source = f"the place of site {name!r}, turned"
    elif outer:
        source = "between the ends of the gripper's fingers"
        if sites:
            elsewhere = ", ".join(repr(model.site(s).name) for s in sites)
            source += f", where {elsewhere} is not"
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


def _fingers(
    data: MjData, outer: Ids, frame: Floats
) -> tuple[Fields, str, float | None]:
    """Return ``fingers`` and their open values in ``held_joints``, if two slide across the hand.

    The columns of ``frame`` (3, 3) are any direction, that across the hand and the approach.
    Also return what was found, in words, and the middle between the fingers across the hand [m].
    """
    if not outer:
        return {}, "", None
    model = data.model
    slides = []
    for j in joints_of(model, outer):
        is_across = abs(data.xaxis[j] @ frame[:, 1]) > AGREEING_COSINE
        if is_slide(model, j) and is_across and model.joint(j).name:
            slides.append(j)
    bodies = model.jnt_bodyid[slides].tolist()
    tips = [_tip(data, finger, frame[:, 2]) for finger in bodies]
    if not set(tips) & set(bodies):  # else what one finger carries is something else
        bodies = tips
    names = [model.body(body).name for body in bodies]
    geoms = [geoms_of(model, [body]).tolist() for body in bodies]
    if len(slides) != 2 or bodies[0] == bodies[1] or not all([*names, *geoms]):
        return {}, "; no fingers: two named ones have to slide across the hand", None
    opening = widest_opening(data, slides, geoms, frame)
    if opening is None:
        joints = " and ".join(joint_names(model, slides))
        return {}, f"; no fingers, as {joints} have no range", None
    both = " and ".join(names)
    gap_m, middle_m, values = opening
    if gap_m < LEAST_M:
        return {}, f"; no fingers, as {both} overlap at all their ends", None
    text = f"{both}, open by {100 * gap_m:.1f} cm"
    if gap_m > MOST_M:
        return {}, f"; no fingers: {text}, as no gripper does", None
    return {"fingers": names, "held_joints": values}, f"; fingers: {text}", middle_m


def _tip(data: MjData, finger: int, approach: Floats) -> int:
    """Return the named body fixed to a finger that reaches farthest out of the hand, or itself."""

    def reach(body: int) -> float:
        return extent(data, geoms_of(data.model, [body]), approach)

    named = [b for b in fixed_to(data.model, [finger]) if data.model.body(b).name]
    tip = max(named, key=reach, default=finger)
    if reach(tip) > reach(finger) + SAME_M:
        return tip
    return finger


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
    along_centres = centres @ approach
    end = max(along_centres.max(), extent(data, geoms, approach))
    if fingers:  # which grasp a little before their ends
        end -= 0.1 * (end - origin @ approach)
    else:
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


def _across(data: MjData, fingers: Ids, approach: Floats) -> Floats:
    """Return the direction in which the fingers open, world, perpendicular to the approach."""
    model = data.model
    joints = joints_of(model, fingers)
    between = data.xpos[fingers[1:]] - data.xpos[fingers[:1]]
    slides = [j for j in joints if is_slide(model, j)]
    swings = joints if len(fingers) == 1 else []  # of a jaw that turns
    swept = np.cross(data.xaxis[swings], approach)
    candidates = np.vstack([between, data.xaxis[slides], swept, _HORIZONTAL])
    flat = candidates - np.outer(candidates @ approach, approach)
    lengths = norm(flat, axis=1)
    is_across = lengths > 0.3 * norm(candidates, axis=1)
    first = is_across.argmax()
    return np.asarray(flat[first] / lengths[first])
