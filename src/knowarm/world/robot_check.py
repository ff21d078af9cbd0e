"""Checks of a robot's description: scene, joints, gripper, servos, reach and visibility."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.world.appearance import TargetColours, resting_colours
from knowarm.world.config import EnvConfig
from knowarm.world.episodes import evaluation_episodes
from knowarm.world.ik import IKSolution, InverseKinematics
from knowarm.world.render.renderer import make_renderer
from knowarm.world.scene import Scene
from knowarm.world.tasks.reach import ACTION_LEVELS, joint_increments
from knowarm.world.vector_env import ReachVectorEnv

MJCF_SUFFIXES = (".xml", ".mjcf")
"""Files with these suffixes hold a bare model, for which a description is drafted."""

SAMPLES = 100
"""Episodes per check."""

MIN_REACHABLE = 0.99
"""Least fraction of target positions with a solution of the inverse kinematics."""

MOVING_SHARE = 0.9
"""Share of the time limit in which a solution has to be reached; servos lag behind."""

MIN_PIXELS = 12
"""Least number of pixels that show a target, in 95 % of the episodes."""

MAX_LAG_RAD = 0.02
"""Largest mean distance of a joint from its target after a control period [rad]."""

DIFFERENCE = 25
"""Change of a colour channel from which a pixel counts as showing the target, of 255."""


@dataclass(frozen=True, kw_only=True)
class Check:
    """Result of one check."""

    name: str
    """What was checked."""

    ok: bool
    """Whether the check passed."""

    found: str
    """What was found, with numbers."""

    remedy: str = ""
    """How to correct it; empty if the check passed."""


def check_robot(
    path: Path | str,
    targets: Sequence[str] = EnvConfig().targets,
    *,
    angle_deg: float = 15.0,
    ignore_roll: bool = False,
) -> list[Check]:
    """Check a robot's description.

    Args:
        path: a TOML description or a name in ``ROBOTS``.
        targets: names or TOML files of the objects that it should reach.
        angle_deg: orientation tolerance of the task [deg].
        ignore_roll: whether the task ignores the rotation about the approach axis.

    Returns:
        The results in order; only the first if the scene cannot be built.
    """
    config = EnvConfig(
        robot=str(path),
        targets=tuple(targets),
        success_angle_deg=angle_deg,
        ignore_roll=ignore_roll,
    )
    try:
        env = ReachVectorEnv(config, SAMPLES)
    except UserError as error:
        return [check_result("scene", False, str(error), "Correct the named field.")]
    scene = env.scene
    joints = ", ".join(
        f"{name} [{low:.2f}, {high:.2f}]"
        for name, low, high in zip(
            scene.robot.joints, scene.joint_lower, scene.joint_upper, strict=True
        )
    )
    checks = [
        check_result("scene", True, f"compiles, {scene.model.ngeom} geoms"),
        check_result("joints", True, joints),
        _check_gripper(env),
        _check_servos(env),
    ]
    for name in targets:
        one = ReachVectorEnv(replace(config, targets=(name,), colours="randomized"), SAMPLES)
        checks += [_check_reach(one), *_check_visible(one)]
    return checks


def check_result(name: str, ok: bool, found: str, remedy: str = "") -> Check:
    """Return a check, with the remedy only if it failed."""
    return Check(name=name, ok=ok, found=found, remedy="" if ok else remedy)


def _check_gripper(env: ReachVectorEnv) -> Check:
    """Check that at home the approach axis points down or ahead, not up."""
    env.reset(options={"episodes": evaluation_episodes(env.scene, env.config, SAMPLES, 0)})
    position = env.simulation.tcp_position.mean(axis=0)
    approach = env.simulation.tcp_matrix[:, 2::3].mean(axis=0)
    above = position[2] > env.scene.robot.support_height_m
    return check_result(
        "gripper",
        bool(above and approach[2] < 0.5),
        f"starts at {np.round(position, 3).tolist()} m, approach (z) is "
        f"{np.round(approach, 2).tolist()}",
        "The gripper should start above the support, its site's z axis pointing out of the "
        "fingers: change home, tcp_site, or tcp_quaternion.",
    )


def _check_servos(env: ReachVectorEnv) -> Check:
    """Check the distance of the joints from their targets under random actions."""
    env.reset(options={"episodes": evaluation_episodes(env.scene, env.config, SAMPLES, 0)})
    generator = np.random.default_rng(0)
    lags = []
    for _ in range(10):
        env.step(generator.integers(len(ACTION_LEVELS), size=env.action_space.shape))
        lags.append(np.abs(env.joint_positions - env.joint_targets))
    lag = float(np.mean(lags, axis=(0, 1)).max())
    return check_result(
        "servos",
        lag < MAX_LAG_RAD,
        f"mean distance from target after a step at most {lag:.4f} rad per joint",
        f"Above {MAX_LAG_RAD}: raise servo_frequency_hz, or look for links that collide with "
        "the support, and for damping or friction meant to hold a joint still.",
    )


def _check_reach(env: ReachVectorEnv) -> Check:
    """Solve the inverse kinematics at positions over the whole rectangle."""
    episodes = evaluation_episodes(env.scene, env.config, SAMPLES, 1)
    env.reset(options={"episodes": episodes})
    solver = InverseKinematics(env.scene, ignore_roll=env.config.ignore_roll)
    solution = solver.solve(env.grasp_position, env.grasp_matrix, env.joint_positions)
    reached = is_reachable(solution, env.joint_positions, env.scene, env.config)
    share = float(reached.mean())
    remedy = ""
    if share < MIN_REACHABLE:
        missed = ~reached
        x, y = episodes.position[missed].mean(axis=0)
        remedy = (
            f"Not reached: positions around x {x:.2f}, y {y:.2f} m (median error "
            f"{np.median(solution.distance[missed]):.3f} m, "
            f"{np.median(solution.angle[missed]):.0f} deg, "
            f"{100 * solution.contact[missed].mean():.0f} % in contact): move or shrink the "
            "rectangle, or turn the target with target_yaws_deg."
        )
    return check_result(
        f"reach of {env.scene.targets[0].name}",
        share >= MIN_REACHABLE,
        f"{100 * share:.0f} % of {SAMPLES} positions reachable in time and without contact",
        remedy,
    )


def is_reachable(
    solution: IKSolution, start: NDArray[np.float64], scene: Scene, config: EnvConfig
) -> NDArray[np.bool_]:
    """Return which solutions an episode can reach from joint angles (n, J) within its limits.

    These are the thresholds of success, no contact, and `MOVING_SHARE` of the steps.
    """
    largest = joint_increments(scene.robot, config).max()
    steps = np.abs(solution.joints - start).max(axis=1) / largest
    reached = solution.within(config.success_distance_m, config.success_angle_deg)
    return np.asarray(reached & (steps <= MOVING_SHARE * config.max_episode_steps))


def _check_visible(env: ReachVectorEnv) -> list[Check]:
    """Count the pixels in which the images with and without the target differ."""
    scene, simulation = env.scene, env.simulation
    renderer = make_renderer(scene, env.config, env.config.image_size)
    poses = simulation.geom_position, simulation.geom_matrix
    hidden = renderer.draw(*poses, resting_colours(scene, SAMPLES)).astype(np.int16)
    checks = []
    for c, colour in enumerate(scene.colour_names[0]):
        first = np.zeros(SAMPLES, dtype=np.int64)
        shown = renderer.draw(*poses, TargetColours(scene)(first, np.full_like(first, c)))
        pixels = (np.abs(shown - hidden).max(axis=-1) > DIFFERENCE).sum(axis=(1, 2))
        few = float(np.percentile(pixels, 5))
        checks.append(
            check_result(
                f"{colour} {scene.targets[0].name} in the image",
                few >= MIN_PIXELS,
                f"in {np.median(pixels):.0f} pixels (median), {few:.0f} (5th percentile)",
                f"Fewer than {MIN_PIXELS}: move the camera nearer or to the side "
                "(camera_position_m), narrow camera_fovy_deg, or choose a colour that differs "
                "from the support's.",
            )
        )
    return checks
