"""Scene of lifting: fingers that move, and objects that are solid and free to move."""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from mujoco import (
    MjData,
    MjModel,
    MjsBody,
    MjSpec,
    mj_geomDistance,
    mj_versionString,
    mjNEQDATA,
    mjtCone,
    mjtEq,
    mjtGeom,
    mjtJoint,
    mjtLimited,
    mjtObj,
    mjtSensor,
    mjtTrn,
    mju_mat2Quat,
)

from knowarm.arrays import Floats, Indices
from knowarm.errors import UserError
from knowarm.world.batch import MUJOCO
from knowarm.world.objects.target import Target
from knowarm.world.robots.robot import FINGERS_JOINT, Robot
from knowarm.world.scene.compose import ROBOT_BIT, ROBOT_PREFIX, SUPPORT_BIT, compose
from knowarm.world.scene.mjcf import drawn, read_mjcf
from knowarm.world.scene.scene import Fingers, Scene, compiling, describe_model
from knowarm.world.scene.surface import solid_geoms, surface_points

OBJECT_BIT = 4  # Contact bit of objects, beside those of robot and support
TIMESTEP_S = 0.004  # From .005 on objects slip
IMPRATIO = 10.0  # Stiffness of friction over that of normal forces; less lets held objects creep
# Sliding, torsional [m] and rolling [m] friction of fingers
PAD_FRICTION = (1.0, 0.005, 0.0001)
PAD_SOLREF = (0.004, 1.0)  # Stiff contacts of the fingers
PAD_SOLIMP = (0.95, 0.99)
GRIP_FORCE_N = 40.0  # Largest force of each finger
FINGER_GAIN_N_M = 4_000.0  # Gain of the fingers' position servos
FINGER_DAMPING_N_S_M = 80.0
LEAST_OPENING_M = 0.005  # Fingers that are drawn nearer to each other are closed
STAYS_M = 1e-5  # Range of a finger that stays
SQUEEZE_M = 0.02  # Way past closed of the servos, so that thin parts are gripped with full force
PAD_M = 0.03  # Length of what grips of a finger behind the tool centre point
SUNK_M = 0.002  # Depth below the support from which a shape does not stand on it

OLDEST_MUJOCO = (3, 16)
"""Version from which on bodies of an attached file can be renamed and moved."""

FINGERS = ("left", "right")
"""Names of the fingers' bodies, joints and sensors in the model."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LiftScene(Scene):
    """A scene whose last joint are the fingers, and whose K targets are free bodies."""

    bodies: Indices  # Body of each target, (K,)
    object_qpos: Indices  # Index in qpos of each target's x, (K,)
    rest: Floats  # Pose of each target on the support, x and y apart, (K, 7)


def build_lift_scene(
    robot: Robot,
    targets: Sequence[Target],
    distractors: int = 0,
    timestep_s: float = TIMESTEP_S,
    furnish: Callable[[MjSpec], None] = lambda spec: None,
) -> LiftScene:
    """Compose and compile the scene of an arm that lifts.

    The arm with its servos is that of `compose`. The robot's ``fingers``, of which bodies grip with
    a box each, slide along the y axis of the tool centre point, coupled as in a parallel gripper,
    by up to ``GRIP_FORCE_N`` each. Objects have their mass, distributed as in their file over its
    shapes, which collide with robot, support and each other. Friction cones are elliptic.
    ``furnish`` adds what else stands there.

    Raises:
        UserError: the robot names no fingers, or its file lacks them; MuJoCo is too old.
    """
    if MUJOCO < OLDEST_MUJOCO:
        raise UserError(
            f"Fingers and solid objects need MuJoCo 3.16, and {mj_versionString()} is installed: "
            "pip install 'mujoco>=3.16', or take a task that reaches."
        )
    with compiling(robot, targets):
        spec = compose(robot, targets, distractors)
        furnish(spec)
        spec.option.timestep = timestep_s
        spec.option.cone = mjtCone.mjCONE_ELLIPTIC
        spec.option.impratio = IMPRATIO
        _add_pads(spec, drawn(spec), robot)
        data = drawn(spec)
        opening = _move_fingers(spec, data, robot)
        rest = np.stack([_free(spec, data, robot, target) for target in targets])
        names = [_body_name(spec, target) for target in targets]
        for name, finger in product(names, FINGERS):
            _sense_touch(spec, finger, name)
        model = spec.compile()
    scene = dict(vars(describe_model(model, robot, targets, distractors)))
    scene["joint_names"] = (*robot.joints, FINGERS_JOINT)
    closed = opening * robot.finger_shares[0]
    scene["fingers"] = Fingers(closed_m=closed, force_n=GRIP_FORCE_N)
    last = {
        "qpos_index": model.joint(FINGERS[0]).qposadr,
        "joint_lower": 0.0,
        "joint_upper": closed + SQUEEZE_M,
        "home": 0.0,
    }
    for name, value in last.items():
        scene[name] = np.append(scene[name], value)
    bodies = np.array([model.body(name).id for name in names], np.intp)
    object_qpos = model.jnt_qposadr[model.body_jntadr[bodies]].astype(np.intp)
    return LiftScene(**scene, bodies=bodies, object_qpos=object_qpos, rest=rest)


def _tcp_frame(data: MjData, robot: Robot) -> tuple[Floats, Floats]:
    """Return position (3,) and rotation (3, 3) of the tool centre point (TCP)."""
    tcp = data.model.site(ROBOT_PREFIX + robot.tcp_site).id
    return data.site_xpos[tcp], data.site_xmat[tcp].reshape(3, 3)


def _add_pads(spec: MjSpec, data: MjData, robot: Robot) -> None:
    """Let each finger that is a body grip with one box, around what it has near the TCP.

    In the grip of hulls of meshes and of several small geoms, objects turn and creep. Geoms that
    are named as fingers grip as they are.
    """
    model = data.model
    origin, frame = _tcp_frame(data, robot)
    for name in robot.fingers:
        body = spec.body(ROBOT_PREFIX + name)
        if body is None:
            continue
        number = model.body(body.name).id
        geoms = solid_geoms(model, [number])
        if not geoms:
            continue
        surfaces = np.concatenate([surface_points(data, geom) for geom in geoms])
        points = (surfaces - origin) @ frame
        near = points[points[:, 2] > -PAD_M]
        if len(near):
            points = near
        low = points.min(axis=0)
        high = points.max(axis=0)
        for geom in body.geoms:
            geom.contype = 0
            geom.conaffinity = 0
        turn = data.xmat[number].reshape(3, 3).T
        quat = np.zeros(4)
        mju_mat2Quat(quat, (turn @ frame).ravel())
        _add_hidden(
            body,
            type=mjtGeom.mjGEOM_BOX,
            size=np.maximum((high - low) / 2, 1e-4),
            pos=turn @ (origin + frame @ (low + high) / 2 - data.xpos[number]),
            quat=quat,
            contype=ROBOT_BIT,
        )


def _add_hidden(body: MjsBody, **fields: Any) -> None:
    """Add a massless, invisible geom that collides with the support."""
    body.add_geom(mass=0, conaffinity=SUPPORT_BIT, rgba=[0, 0, 0, 0], **fields)


def _move_fingers(spec: MjSpec, data: MjData, robot: Robot) -> float:
    """Give the fingers slides towards each other and a servo; return the gap between them [m]."""
    if len(robot.fingers) != 2:
        raise UserError(
            f"Robot {robot.name!r} names no fingers, so nothing can be lifted; set fingers to the "
            "names of two bodies or geoms of its MJCF file."
        )
    model = data.model
    geoms = [_finger_geoms(spec, model, robot, name) for name in robot.fingers]
    for name, ids in zip(robot.fingers, geoms, strict=True):
        if not ids:
            raise UserError(
                f"Robot {robot.name!r}: fingers names the body {name!r}, which has no geoms; name "
                "the bodies that hold those of the fingers."
            )
    opening = min(
        mj_geomDistance(model, data, a, b, 1.0, None) for a, b in product(*geoms)
    )
    if opening < LEAST_OPENING_M:
        raise UserError(
            f"Robot {robot.name!r}: its fingers {' and '.join(robot.fingers)} touch where they are "
            "drawn; open them with held_joints, or name as fingers the geoms of their tips. "
            f"{_finger_joints(robot)}"
        )
    origin, tcp_frame = _tcp_frame(data, robot)
    across = tcp_frame[:, 1]
    shares = robot.finger_shares
    fingers = zip(robot.fingers, FINGERS, geoms, shares, strict=True)
    for name, finger, (geom, *_), share in fingers:
        inward = -across * np.sign((data.geom_xpos[geom] - origin) @ across)
        frame = data.xmat[model.geom_bodyid[geom]].reshape(3, 3)
        body = spec.body(ROBOT_PREFIX + name)
        if body is None:
            body = _geom_to_body(spec, model, geom)
        body.name = finger
        _add_slide(spec, body, frame.T @ inward, max(opening * share, STAYS_M))
    spec.add_equality(
        type=mjtEq.mjEQ_JOINT,
        name1=FINGERS[1],
        name2=FINGERS[0],
        data=np.eye(1, mjNEQDATA, 1)[0] * shares[1] / shares[0],  # 0, ratio, 0, 0, ...
    )
    return float(opening)


def _finger_joints(robot: Robot) -> str:
    """Name the joints of the fingers in the robot's file, with their ranges."""
    file = read_mjcf(robot.mjcf, f"Robot {robot.name!r}").compile()
    named = np.isin([file.body(b).name for b in range(file.nbody)], robot.fingers)
    ranges = []
    for number in range(file.njnt):
        joint = file.joint(number)
        if named[file.body_weldid == joint.bodyid[0]].any():
            low, high = joint.range
            ranges.append(f"{joint.name} of {low:g} to {high:g}")
    return (
        f"Their joints: {', '.join(ranges) or 'none, they are drawn so in the file'}."
    )


def _add_slide(spec: MjSpec, finger: MjsBody, axis: Floats, range_m: float) -> None:
    """Give a finger a slide along an axis of its frame, a servo, and geoms that grip."""
    finger.add_joint(
        name=finger.name,
        type=mjtJoint.mjJNT_SLIDE,
        axis=axis,
        limited=mjtLimited.mjLIMITED_TRUE,
        range=[0.0, range_m],
        damping=[FINGER_DAMPING_N_S_M, 0, 0],
        armature=0.1,
        solref_limit=PAD_SOLREF,
    )
    for geom in finger.geoms:
        geom.friction = PAD_FRICTION
        geom.condim = 4
        geom.solref = PAD_SOLREF
        geom.solimp[:2] = PAD_SOLIMP
        geom.priority = 1
    servo = spec.add_actuator(
        name=finger.name,
        target=finger.name,
        trntype=mjtTrn.mjTRN_JOINT,
    )
    servo.set_to_position(kp=FINGER_GAIN_N_M)
    servo.forcelimited = True
    servo.forcerange = [-GRIP_FORCE_N, GRIP_FORCE_N]


def _finger_geoms(spec: MjSpec, model: MjModel, robot: Robot, name: str) -> list[int]:
    """Return the ids of a finger's geoms that grip."""
    full_name = ROBOT_PREFIX + name
    if spec.body(full_name) is not None:
        is_own = model.geom_bodyid == model.body(full_name).id
        return np.flatnonzero(is_own & (model.geom_contype != 0)).tolist()
    if spec.geom(full_name) is None:
        raise UserError(
            f"Robot {robot.name!r}: fingers names {name!r}, which {robot.mjcf.name} has neither as "
            "body nor as geom."
        )
    return [model.geom(full_name).id]


def _geom_to_body(spec: MjSpec, model: MjModel, number: int) -> MjsBody:
    """Move a geom into a body of its own, at the frame of the body it was in."""
    old = spec.geom(model.geom(number).name)
    names = "name type meshname material rgba mass density group contype conaffinity"
    fields = {name: copy(getattr(old, name)) for name in names.split()}
    if old.type == mjtGeom.mjGEOM_MESH:  # whose compiled pose is that of its inertia
        fields["pos"] = copy(old.pos)
        fields["quat"] = copy(old.quat)
    else:
        fields["pos"] = model.geom_pos[number]
        fields["quat"] = model.geom_quat[number]
    parent = old.parent
    spec.delete(old)
    body = parent.add_body(gravcomp=1)
    body.add_geom(size=model.geom_size[number], **fields)
    return body


def _body_name(spec: MjSpec, target: Target) -> str:
    """Return the name of a target's body in the model."""
    return str(spec.site(f"{target.name}/{target.grasp_site}").parent.name)


def _free(spec: MjSpec, data: MjData, robot: Robot, target: Target) -> Floats:
    """Make a target a solid free body with its mass; return its pose on the support, (7,)."""
    model = data.model
    support = model.geom("table" if robot.table else "floor").id
    body = spec.body(_body_name(spec, target))
    number = model.body(body.name).id
    body.mocap = False
    body.add_freejoint()
    if target.mass_kg is not None:
        _set_mass(body, target.mass_kg, model.body_mass[number])
    lowest = 0.0
    for geom in body.geoms:
        geom.contype = OBJECT_BIT
        geom.conaffinity = ROBOT_BIT | OBJECT_BIT
        gap = mj_geomDistance(model, data, model.geom(geom.name).id, support, 1.0, None)
        if gap > -SUNK_M:
            geom.conaffinity |= SUPPORT_BIT
            lowest = min(lowest, gap)
    if target.base_radius_m:
        half = 0.002
        _add_hidden(
            body,
            type=mjtGeom.mjGEOM_CYLINDER,
            size=[target.base_radius_m, half, 0],
            pos=[0, 0, half],
            contype=0,
        )
    height = data.xpos[number, 2] - lowest
    return np.array([0.0, 0.0, height, *data.xquat[number]])


def _set_mass(body: MjsBody, mass_kg: float, own_kg: float) -> None:
    """Scale the masses of a body, of which its file gives ``own_kg`` together."""
    for geom in body.geoms:
        geom.density = geom.density * mass_kg / own_kg
        # Not a number where the density is given
        geom.mass = geom.mass * mass_kg / own_kg
    body.mass = body.mass * mass_kg / own_kg  # of bodies that give it themselves
    body.inertia = body.inertia * (mass_kg / own_kg)
    body.fullinertia = body.fullinertia * (mass_kg / own_kg)


def _sense_touch(spec: MjSpec, finger: str, body: str) -> None:
    """Add a sensor that counts the contacts between a finger and an object."""
    spec.add_sensor(
        name=f"{body} {finger}",
        type=mjtSensor.mjSENS_CONTACT,
        objtype=mjtObj.mjOBJ_BODY,
        objname=finger,
        reftype=mjtObj.mjOBJ_BODY,
        refname=body,
        intprm=[1, 0, 1],
    )
