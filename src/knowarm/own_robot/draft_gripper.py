"""Arm and gripper of a bare MJCF file: the joints that the agent moves, and the TCP."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from mujoco import MjData, MjModel, mj_kinematics, mj_name2id, mjtObj, mju_mat2Quat
from numpy.linalg import norm

from knowarm.arrays import Floats, Integers
from knowarm.errors import UserError
from knowarm.own_robot.draft_chain import (
    JAW_SHARE,
    MOVABLE,
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
from knowarm.own_robot.opening import (
    LEAST_M,
    MOST_DRIVERS,
    MOST_M,
    SAME_M,
    Motion,
    solid_geoms,
    widest_opening,
)
from knowarm.own_robot.poses import Fields

AGREEING_COSINE = 0.7
"""From this cosine on a site's z axis counts as the approach direction."""

TOOL_M = 0.05
"""Distance of the tool centre point in front of an arm that ends at its flange [m]."""


ASIDE_M = 0.03  # Farthest from the middle between fingers that a tool frame lies aside
AHEAD_M = 0.06  # Farthest beyond their ends
BEFORE = 0.1  # Share of a hand's length that the TCP lies before the fingers' ends
FINGERTIP_M = 0.01  # Parts that end nearer to a finger's end are fingers too
STILL = {
    "suction|vacuum": "it holds by suction",
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
    fingers, text, across, tip = _fingers(data, inside, outer, approach)
    frame = np.stack([np.cross(across, approach), across, approach], axis=1)
    if tip is not None:
        point = tip - BEFORE * ((tip - data.xanchor[last]) @ approach) * approach
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
    data: MjData, inside: Ids, outer: Ids, approach: Floats
) -> tuple[Fields, str, Floats, Floats | None]:
    """Return ``fingers`` and their open values in ``held_joints``, if two move across a hand.

    ``inside`` are the hand and all bodies on it, of which ``outer`` have joints. Also return what
    was found, in words, the direction across the hand, and the middle between the fingers' ends
    [m], each of world (3,).
    """
    model = data.model
    across = _across(data, outer, approach)
    if not outer:
        return {}, _still(model, inside), across, None
    joints = [j for j in joints_of(model, outer) if model.jnt_type[j] in MOVABLE]
    motion = Motion(data, joints)
    groups = []
    for body in sorted({*model.body_weldid[outer].tolist()}):
        geoms = solid_geoms(data, fixed_to(model, [body]))
        if geoms:
            groups.append(geoms)
    shifts = motion.shifts(groups)
    moved = norm(shifts, axis=2) > SAME_M
    if not moved.any():
        names = " and ".join(joint_names(model, joints))
        return {}, f"; no fingers, as {names} have no range with two ends", across, None
    reach = np.array([extent(data, np.array(geoms), approach) for geoms in groups])
    farthest = int(np.where(moved.any(axis=0), reach, -np.inf).argmax())
    way = shifts[norm(shifts[:, farthest], axis=1).argmax(), farthest]
    flat = way - (way @ approach) * approach
    if norm(flat) > 0.3 * norm(way):
        across = flat / norm(flat) * (1 if flat @ across >= 0 else -1)
    pair, reason = _pair(model, motion, groups, shifts @ across, reach)
    if reason:
        return {}, f"; no fingers: {reason}", across, None
    drivers = [motion.drivers[k] for k in np.flatnonzero(moved[:, pair].any(axis=1))]
    frame = np.stack([np.cross(across, approach), across, approach], axis=1)
    fingers = [groups[k] for k in pair]
    opening = widest_opening(motion, drivers, fingers, frame)
    if opening is None:
        reason = f"; no fingers: {_listed(model, drivers)} reach no end, as loops do not close"
        return {}, reason, across, None
    names = [_main_body(model, geoms, opening.counts) for geoms in fingers]
    both = " and ".join(names)
    if not all(names):
        return {}, "; no fingers, as their bodies have no names", across, None
    if opening.gap_m < LEAST_M:
        return {}, f"; no fingers, as {both} overlap at all their ends", across, None
    text = f"{both}, open by {100 * opening.gap_m:.1f} cm"
    if opening.gap_m > MOST_M:
        return {}, f"; no fingers: {text}, as no gripper does", across, None
    fields: Fields = {"fingers": names, "held_joints": opening.joints}
    return fields, f"; fingers: {text}", across, opening.tip


def _still(model: MjModel, bodies: Ids) -> str:
    """Return why a hand on which nothing moves has no fingers; '' for a bare flange."""
    names = " ".join(model.body(body).name for body in bodies)
    for words, reason in STILL.items():
        if re.search(words, names, re.IGNORECASE):
            return f"; no fingers: {reason}"
    return ""


def _pair(
    model: MjModel,
    motion: Motion,
    groups: Sequence[Ids],
    shifts: Floats,
    reach: Floats,
) -> tuple[Ids, str]:
    """Return the two groups of geoms that are fingers, or why there are none.

    ``shifts`` (drivers, groups) are how far each driver moves them across the hand, and ``reach``
    how far they reach out of it [m]. On each side the one that reaches farthest is a finger.
    """
    sides: dict[tuple[int, bool], Ids] = {}
    for k in np.argsort(-reach).tolist():
        driver = int(np.abs(shifts[:, k]).argmax())
        if abs(shifts[driver, k]) > SAME_M:
            sides.setdefault((driver, shifts[driver, k] > 0), []).append(k)
    pair = sorted(members[0] for members in [*sides.values()][:2])
    if len(pair) < 2:
        name = _main_body(model, groups[pair[0]], {}) if pair else "nothing"
        return pair, f"{name} moves alone across the hand, and lifting moves two"
    drivers = np.flatnonzero((np.abs(shifts[:, pair]) > SAME_M).any(axis=1))
    if len(drivers) > MOST_DRIVERS:
        names = _listed(model, [motion.drivers[k] for k in drivers])
        return pair, (
            f"{len(drivers)} joints move them that the file couples by no mimic or equality, as a "
            f"URDF has no closed loops: {names}"
        )
    roots = set()
    for members in sides.values():
        for k in members:
            if reach[k] > reach[pair].min() - FINGERTIP_M:
                roots.add(motion.root(groups[k]))
    if len(roots) > 2:
        return pair, f"{len(roots)} of them close, and lifting moves two"
    return pair, ""


def _listed(model: MjModel, joints: Ids) -> str:
    return ", ".join(joint_names(model, joints))


def _main_body(model: MjModel, geoms: Ids, counts: Mapping[int, int]) -> str:
    """Return the named body that has most points of the fingertip's surface, '' if none."""
    points: dict[str, int] = {}
    for geom in geoms:
        name = model.body(model.geom_bodyid[geom]).name
        points[name] = points.get(name, 0) + counts.get(geom, 0)
    points.pop("", None)
    return max(points, key=points.__getitem__, default="")


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
        end -= BEFORE * (end - origin @ approach)
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


def _across(data: MjData, moving: Ids, approach: Floats) -> Floats:
    """Return a direction across a hand, world: of what moves on it, or horizontal."""
    between = data.xpos[moving[1:]] - data.xpos[moving[:1]]
    joints = joints_of(data.model, moving)
    slides = [j for j in joints if is_slide(data.model, j)]
    swept = np.cross(data.xaxis[joints[:1]], approach)  # by a jaw that turns
    candidates = np.vstack([between, data.xaxis[slides], swept, _HORIZONTAL])
    flat = candidates - np.outer(candidates @ approach, approach)
    lengths = norm(flat, axis=1)
    is_across = lengths > 0.3 * norm(candidates, axis=1)
    first = is_across.argmax()
    return np.asarray(flat[first] / lengths[first])
