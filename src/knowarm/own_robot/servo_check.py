"""Check of the servos: how far the joints stay from their targets, and at which frequency least."""

from dataclasses import replace

import numpy as np

from knowarm.check import Check
from knowarm.own_robot.poses import place_targets
from knowarm.world.scene.compose import ROBOT_PREFIX
from knowarm.world.scene.scene import Scene, build_scene
from knowarm.world.tasks.state import ACTION_LEVELS

ARMS = 50  # Copies of the arm with which the servos are measured
STEPS = 10  # Random actions of each
MAX_LAG_RAD = 0.02  # Largest mean distance of a joint from its target after a control period [rad]
UNSTABLE_RAD = 2 * np.pi
"""A joint that is farther from its target is not controlled at all."""

FREQUENCIES_HZ = (5.0, 3.5, 10.0, 14.0)  # Tried where a servo is not good enough


def servo_lag(scene: Scene) -> float:
    """Return the mean distance of the worst joint from its target under random actions [rad]."""
    generator = np.random.default_rng(0)
    simulation = place_targets(scene, scene.home, np.zeros((ARMS, 2)))
    targets = simulation.joint_positions
    lags = []
    for _ in range(STEPS):
        levels = generator.choice(ACTION_LEVELS, size=targets.shape)
        targets = targets + scene.robot.mpi_rad * levels
        targets = targets.clip(scene.joint_lower, scene.joint_upper)
        simulation.step(targets)
        lags.append(np.abs(simulation.joint_positions - targets))
    worst = np.mean(lags, axis=(0, 1)).max()
    return float(np.nan_to_num(worst, nan=np.inf))


def best_frequency(scene: Scene) -> tuple[float, float]:
    """Return the natural frequency [Hz] with the least lag of those tried, and that lag [rad]."""
    lags = {}
    for frequency in FREQUENCIES_HZ:
        robot = replace(scene.robot, servo_frequency_hz=frequency)
        lags[frequency] = servo_lag(build_scene(robot, scene.targets))
        if lags[frequency] < MAX_LAG_RAD:
            break
    best = min(lags, key=lags.__getitem__)
    return best, lags[best]


def check_servos(scene: Scene) -> Check:
    """Check the distance of the joints from their targets under random actions."""
    lag = servo_lag(scene)
    found = f"mean distance from target after a step at most {lag:.4f} rad per joint"
    if lag > UNSTABLE_RAD:
        found = "the simulation is unstable: joints are whole turns from their targets"
    if lag < MAX_LAG_RAD:
        return Check("servos", True, found)
    frequency, best = best_frequency(scene)
    remedy = f"Above {MAX_LAG_RAD}: servo_frequency_hz = {frequency} gives {best:.4f}."
    if best >= MAX_LAG_RAD:
        joint = scene.model.joint
        names = [n for n in scene.joint_names if joint(ROBOT_PREFIX + n).stiffness[0]]
        remedy += (
            " Look for links that collide with the support, for damping or friction meant to hold "
            f"a joint still, and for springs (stiffness of {', '.join(names) or 'no joint'})."
        )
    return Check("servos", False, found, remedy)
