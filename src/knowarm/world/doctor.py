"""A robot of the user's goes in; a list of what is well and what is to be mended comes out."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from knowarm.errors import UserError
from knowarm.world.appearance import TargetColours, resting_colours
from knowarm.world.attach import read_mjcf
from knowarm.world.config import EnvConfig
from knowarm.world.description_file import SUFFIX
from knowarm.world.episodes import evaluation_episodes
from knowarm.world.ik import InverseKinematics
from knowarm.world.objects import TARGETS
from knowarm.world.render.renderer import make_renderer
from knowarm.world.tasks.reach import ACTION_LEVELS
from knowarm.world.vector_env import ReachVectorEnv

SAMPLES = 100
MIN_REACHABLE = 0.99
MIN_PIXELS = 12
MAX_LAG_RAD = 0.02


@dataclass(frozen=True, kw_only=True)
class Check:
    """One thing that was looked at."""

    name: str
    """What was looked at."""

    ok: bool
    """Whether it is well."""

    found: str
    """What was found, with figures."""

    remedy: str = ""
    """What to do about it; empty when all is well."""


def check_robot(path: Path | str, targets: Sequence[str] = tuple(TARGETS)) -> list[Check]:
    """Check a robot's description: model, joints, gripper, image, reach, visibility, servos.

    Args:
        path: a TOML description, a name in ``ROBOTS``, or a bare MJCF file, for which the
            description that is still to be written is shown.
        targets: names or TOML files of the objects it should reach.

    Returns:
        The checks in their order; it ends at the first that stops the scene from being built.
    """
    if str(path).endswith((".xml", ".mjcf")):
        return _check_mjcf(Path(path))
    config = EnvConfig(robot=str(path), targets=tuple(targets), success_angle_deg=15.0)
    try:
        env = ReachVectorEnv(config, SAMPLES)
    except UserError as error:
        return [Check(name="scene", ok=False, found=str(error), remedy="Mend the named field.")]
    scene = env.scene
    joints = ", ".join(
        f"{name} [{low:.2f}, {high:.2f}]"
        for name, low, high in zip(
            scene.robot.joints, scene.joint_lower, scene.joint_upper, strict=True
        )
    )
    checks = [
        Check(name="scene", ok=True, found=f"compiles, {scene.model.ngeom} geoms"),
        Check(name="joints", ok=True, found=joints),
        _check_gripper(env),
        _check_servos(env),
    ]
    for name in targets:
        one = ReachVectorEnv(
            EnvConfig(robot=str(path), targets=(name,), colours="randomized"), SAMPLES
        )
        checks += [_check_reach(one), *_check_visible(one)]
    return checks


def _check_mjcf(path: Path) -> list[Check]:
    """Say what a bare MJCF file offers, and what has to be written beside it."""
    try:
        model = read_mjcf(path, str(path)).compile()
    except UserError as error:
        return [Check(name="MJCF", ok=False, found=str(error), remedy="Mend the file.")]
    movable = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    joints = [
        model.joint(j).name
        for j in range(model.njnt)
        if any(model.jnt_type[j] == kind for kind in movable) and model.jnt_limited[j]
    ]
    sites = [model.site(s).name for s in range(model.nsite)]
    checks = [
        Check(name="MJCF", ok=True, found=f"compiles: {model.nbody - 1} bodies"),
        Check(
            name="joints",
            ok=bool(joints),
            found=f"with a range: {', '.join(joints) or 'none'}",
            remedy="" if joints else "Give the arm's joints a range.",
        ),
        Check(
            name="sites",
            ok=bool(sites),
            found=", ".join(filter(None, sites)) or "none",
            remedy="" if sites else "Set tcp_body, and the site is added there.",
        ),
    ]
    template = path.with_suffix(SUFFIX)
    home = ", ".join("0.0" for _ in joints)
    names = ", ".join(f'"{name}"' for name in joints)
    text = (
        f'mjcf = "{path.name}"; joints = [{names}]; home = [{home}]; tcp_site = "..."; '
        "rectangle_centre_m = [x, y]; rectangle_half_size_m = [x, y]; target_yaw_deg = -135.0; "
        "camera_position_m = [x, y, z]; camera_look_at_m = [x, y, z]; camera_fovy_deg = 40.0"
    )
    return [
        *checks,
        Check(
            name="description",
            ok=False,
            found="an MJCF file alone does not say where the task is",
            remedy=f"Write {template} with, a line each: {text}. Then check that file.",
        ),
    ]


def _check_gripper(env: ReachVectorEnv) -> Check:
    """At home the approach axis should look down or ahead, not up."""
    env.reset(options={"episodes": evaluation_episodes(env.scene, env.config, SAMPLES, 0)})
    position = env.simulation.tcp_position.mean(axis=0)
    approach = env.simulation.tcp_matrix[:, 2::3].mean(axis=0)
    above = position[2] > env.scene.robot.support_height_m
    well = bool(above and approach[2] < 0.5)
    return Check(
        name="gripper",
        ok=well,
        found=f"starts at {np.round(position, 3).tolist()} m, approach (z) is "
        f"{np.round(approach, 2).tolist()}",
        remedy=""
        if well
        else "The gripper should start above the support, its site's z axis pointing out of the "
        "fingers: change home, tcp_site, or tcp_quaternion.",
    )


def _check_servos(env: ReachVectorEnv) -> Check:
    env.reset(options={"episodes": evaluation_episodes(env.scene, env.config, SAMPLES, 0)})
    generator = np.random.default_rng(0)
    lags = []
    for _ in range(10):
        env.step(generator.integers(len(ACTION_LEVELS), size=env.action_space.shape))
        lags.append(np.abs(env.joint_positions - env.joint_targets))
    lag = float(np.mean(lags, axis=(0, 1)).max())
    well = lag < MAX_LAG_RAD
    return Check(
        name="servos",
        ok=well,
        found=f"mean distance from target after a step at most {lag:.4f} rad a joint",
        remedy=""
        if well
        else f"Above {MAX_LAG_RAD}: raise servo_frequency_hz, or look for links that collide with "
        "the support, and for damping or friction meant to hold a joint still.",
    )


def _check_reach(env: ReachVectorEnv) -> Check:
    """Inverse kinematics at places all over the rectangle."""
    episodes = evaluation_episodes(env.scene, env.config, SAMPLES, 1)
    env.reset(options={"episodes": episodes})
    solver = InverseKinematics(env.scene)
    reach = solver.solve(env.grasp_position, env.grasp_matrix, env.joint_positions)
    reached = reach.within(env.config.success_distance_m, env.config.success_angle_deg)
    share = float(reached.mean())
    well = share >= MIN_REACHABLE
    found = f"{100 * share:.0f} % of {SAMPLES} places reachable without contact"
    remedy = ""
    if not well:
        missed = ~reached
        x, y = episodes.position[missed].mean(axis=0)
        remedy = (
            f"Missed are places around x {x:.2f}, y {y:.2f} m (median left over "
            f"{np.median(reach.distance[missed]):.3f} m, {np.median(reach.angle[missed]):.0f} "
            f"deg, {100 * reach.contact[missed].mean():.0f} % in contact): move or shrink the "
            "rectangle, or turn the target with target_yaws_deg."
        )
    return Check(name=f"reach of {env.scene.targets[0].name}", ok=well, found=found, remedy=remedy)


def _check_visible(env: ReachVectorEnv) -> list[Check]:
    """Pixels in which the image with the target differs from the one without it."""
    scene, simulation = env.scene, env.simulation
    images = make_renderer(scene, env.config, env.config.image_size)
    poses = simulation.geom_position, simulation.geom_matrix
    hidden = images.draw(*poses, resting_colours(scene, SAMPLES)).astype(np.int16)
    checks = []
    for c, colour in enumerate(scene.colour_names[0]):
        first = np.zeros(SAMPLES, dtype=np.int64)
        shown = images.draw(*poses, TargetColours(scene)(first, np.full_like(first, c)))
        pixels = (np.abs(shown - hidden).max(axis=-1) > 25).sum(axis=(1, 2))
        few = float(np.percentile(pixels, 5))
        well = few >= MIN_PIXELS
        checks.append(
            Check(
                name=f"{colour} {scene.targets[0].name} in the image",
                ok=well,
                found=f"in {np.median(pixels):.0f} pixels (median), {few:.0f} (5th percentile)",
                remedy=""
                if well
                else f"Fewer than {MIN_PIXELS}: move the camera nearer or to the side "
                "(camera_position_m), narrow camera_fovy_deg, or take a colour that differs from "
                "the support's.",
            )
        )
    return checks
