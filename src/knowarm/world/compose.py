"""A robot and targets go in; one ``MjSpec`` of the whole scene comes out."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from knowarm.errors import UserError
from knowarm.world.attach import ROBOT_PREFIX, attach_robot, attach_target
from knowarm.world.robot import Robot
from knowarm.world.surroundings import add_distractors, add_surroundings
from knowarm.world.target import Target

CONTROL_PERIOD_S = 0.1
"""Time from one action to the next [s]. MPI / period = 1 rad/s is below every joint's limit."""

SUBSTEPS = 5
"""Physics steps in a control period."""


def compose(robot: Robot, targets: Sequence[Target], distractors: int = 0) -> mujoco.MjSpec:
    """Write the scene: floor, table, lights, camera, robot with servos, targets as mocap bodies.

    Every robot body is gravity compensated. Contacts exist between robot and support only.

    Raises:
        UserError: a file is missing or does not compile, or a named part is not in it.
    """
    spec = mujoco.MjSpec()
    spec.modelname = f"knowarm {robot.name}"
    spec.compiler.degree = False
    spec.option.timestep = CONTROL_PERIOD_S / SUBSTEPS
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    add_surroundings(spec, robot)
    attach_robot(spec, robot)
    for target in targets:
        attach_target(spec, robot, target)
    add_distractors(spec, robot, distractors)
    _add_servos(spec, robot)
    return spec


def _add_servos(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Give each joint a critically damped position servo, tuned to the inertia it moves.

    With m the diagonal of the joint-space inertia at home and w the natural frequency [rad/s], the
    gains are kp = m w^2 and kv = 2 m w.
    """
    model = spec.compile()
    data = mujoco.MjData(model)
    ids = []
    for name, angle in zip(robot.joints, robot.home, strict=True):
        joint = model.joint(ROBOT_PREFIX + name)
        _check_joint(robot, name, joint)
        data.qpos[model.jnt_qposadr[joint.id]] = angle
        ids.append(model.jnt_dofadr[joint.id])
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    frequency = 2 * np.pi * robot.servo_frequency_hz
    for name, dof in zip(robot.joints, ids, strict=True):
        mass = float(inertia[dof, dof])
        actuator = spec.add_actuator(
            name=name, target=ROBOT_PREFIX + name, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        actuator.set_to_position(kp=mass * frequency**2, kv=2 * mass * frequency)


def _check_joint(robot: Robot, name: str, joint: Any) -> None:
    """Refuse joints whose angle is not one number between two limits."""
    kind, limited = int(joint.type[0]), bool(joint.limited[0])
    hinge, slide = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
    if kind not in (hinge, slide) or (kind == slide and not limited):
        raise UserError(
            f"Robot {robot.name!r}: joint {name!r} must be a hinge, or a slide with a range, as "
            "actions are clipped to it; give it a range in the MJCF or leave it out of joints."
        )
