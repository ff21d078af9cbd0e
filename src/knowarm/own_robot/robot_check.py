"""Checks of a robot's description: scene, joints, gripper, servos, reach, visibility."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mujoco import MjsGeom
from scipy.spatial.distance import cdist

from knowarm.arrays import Floats, Images, Mask
from knowarm.check import Check
from knowarm.errors import UserError
from knowarm.own_robot.draft_chain import couplings, joint_name, joints_of, polyline_m
from knowarm.own_robot.grasp_check import check_grasps
from knowarm.own_robot.opening import check_fingers
from knowarm.own_robot.pixels import SceneImages, different_pixels, robot_parts
from knowarm.own_robot.plausible import fixed_parts_above, question_ranges
from knowarm.own_robot.poses import robot_file
from knowarm.own_robot.servo_check import check_servos
from knowarm.questions import object_of
from knowarm.world.agents import OracleAgent, searched_list
from knowarm.world.agents.play import play
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.running import joint_increments
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.scene.compose import ROBOT_PREFIX
from knowarm.world.scene.mjcf import FLOORS, surroundings
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.skills.ik import IKSolution, InverseKinematics

SAMPLES = 100  # Episodes per check
MIN_REACHABLE = 0.99
"""Least fraction of target positions with a solution of the inverse kinematics."""

MOVING_SHARE = 0.9
"""Share of the time limit in which a solution has to be reached; servos lag behind."""

MIN_ROBOT_SHARE = 0.01
"""Least share of the image that shows the robot at its start."""

MAX_PART = 2.0
"""Greatest diameter of one of the robot's geoms relative to the length of the arm."""

MIN_PIXELS = 12  # Least number of pixels that show a target, in 95 % of the episodes
MIN_ORACLE = 0.95  # Least success of the oracle
LEARNABLE_SHARE = 0.6
"""Share of the time limit in which three quarters of the oracle's episodes have to end."""

MAX_BLIND = 0.5  # Greatest success of the best fixed list of actions
EVALUATION_M = 0.10
EVALUATION_DEG = 17.0
"""Thresholds of success of an evaluation; the angle is that of the task where it is easier."""


def check_robot(
    path: Path | str,
    targets: Sequence[str] = EnvConfig().targets,
    *,
    angle_deg: float | None = None,
    ignore_roll: bool = False,
    distance_m: float | None = None,
) -> Iterator[Check]:
    """Check the robot of a TOML description or name for a task with some objects.

    Yield the results in order; only the first if the scene cannot be built. Agents play if all
    else is well. Thresholds that are None are the description's.
    """
    try:
        config = EnvConfig(
            robot=str(path),
            targets=tuple(targets),
            success_angle_deg=angle_deg or 0.0,
            ignore_roll=ignore_roll,
        )
        env = ArmVectorEnv(config, SAMPLES)
    except UserError as error:
        yield Check("scene", False, str(error), "Correct what that line names.")
        return
    env.reset(options={"episodes": evaluation_episodes(config, SAMPLES, 0)})
    failed = 0
    for check in _check_parts(env):
        yield check
        failed += not check.ok
    if not failed:
        distance_m = distance_m or env.scene.robot.evaluation_distance_m or EVALUATION_M
        yield from check_agents(replace(config, image_size=1), distance_m)
        yield from check_grasps(env.scene.robot, config.robot)


def _check_parts(env: ArmVectorEnv) -> Iterator[Check]:
    """Check all but what agents do."""
    scene = env.scene
    yield _check_scene(scene)
    yield check_joints(scene)
    yield _check_robot_in_image(env)
    yield _check_size(scene)
    yield _check_gripper(env)
    if scene.robot.fingers:
        yield check_fingers(scene.robot)
    yield check_servos(scene)
    for name in env.config.targets:
        alone = replace(env.config, targets=(name,), colours="randomized")
        one = ArmVectorEnv(alone, SAMPLES)
        others = [other for other in env.config.targets if other != name]
        yield _check_reach(one, others)
        yield from _check_visible(one)


def _check_scene(scene: Scene) -> Check:
    """Say what of the robot's file is left out, and what of its world is kept as the base."""
    robot = scene.robot
    part = robot_file(robot)
    names = []
    for element in surroundings(part, (*robot.joints, *robot.held_joints)):
        kind = "body"
        if isinstance(element, MjsGeom):
            kind = "floor" if element.type in FLOORS else "geom"
        names.append(
            f"{kind} {element.name!r}" if element.name else f"an unnamed {kind}"
        )
        part.delete(element)
    above = fixed_parts_above(scene)
    lists = {
        f"left out of {robot.mjcf.name}": names,
        "geoms of its world taken for the robot's base": [
            geom.name or "unnamed" for geom in part.worldbody.geoms
        ],
        "textures are drawn as their mean colour": _textured(scene),
        "above the targets' rectangle": above,
    }
    return Check(
        "scene",
        not above,
        f"compiles, {scene.model.ngeom} geoms{_listed(lists)}",
        f"Move what stands above the targets in {robot.mjcf.name} into a body without joints, "
        "which is left out, or move the rectangle (rectangle_centre_m).",
    )


def _listed(lists: Mapping[str, Sequence[str]]) -> str:
    """Return lists by what is in them, without those that are empty."""
    texts = [f"; {what}: {', '.join(names)}" for what, names in lists.items() if names]
    return "".join(texts)


def _textured(scene: Scene) -> list[str]:
    """Return which of the robot and the targets have textures, by name."""
    model = scene.model
    materials = np.flatnonzero((model.mat_texid >= 0).any(axis=1))
    geoms = np.isin(model.geom_matid, materials)
    owners = [
        *scene.targets,
        scene.robot,
    ]  # What belongs to no target, -1, is the robot's
    names = [owners[k].name for k in scene.geom_target[geoms]]
    return list(dict.fromkeys(names))


def check_joints(scene: Scene) -> Check:
    """Check that no joints are coupled in the file; say what is held still and has no range."""
    robot = scene.robot
    file = robot_file(robot).compile()
    named = {*robot.joints, *robot.held_joints}
    ranges = []
    limits = zip(scene.joint_lower, scene.joint_upper, strict=True)
    for name, (low, high) in zip(robot.joints, limits, strict=True):
        limited = scene.model.joint(ROBOT_PREFIX + name).limited[0]
        note = "" if limited else " (no range in the file)"
        ranges.append(f"{name} [{low:.2f}, {high:.2f}]{note}")
    body = (
        file.body(robot.tcp_body).id
        if robot.tcp_body
        else file.site(robot.tcp_site).bodyid[0]
    )
    names = [joint_name(file, j) for j in range(file.njnt)]
    still: list[str] = []
    while body:
        on_body = [names[j] for j in joints_of(file, [body])]
        still += [name for name in on_body if name not in named]
        body = file.body_parentid[body]
    freed = []
    is_free = True
    for group in couplings(file):
        coupled = [names[j] for j in group]
        if named.intersection(coupled):
            freed.append(" and ".join(coupled))
        is_free &= len(set(robot.joints).intersection(coupled)) < 2
    lists = {
        "held still between base and gripper": still,
        "coupled in the file, not in the scene": freed,
    }
    remedy = (
        "The agent would move coupled joints as the robot cannot. Couplings are not simulated: "
        "remove them from the file only if the robot's joints are free of each other."
    )
    question, toml = question_ranges(scene)
    if question:
        remedy = f"As to ranges, {question}: {toml}."
    found = ", ".join(ranges) + _listed(lists)
    return Check("joints", is_free and not question, found, remedy)


def _check_robot_in_image(env: ArmVectorEnv) -> Check:
    """Check that the image shows the robot."""
    pixels = SceneImages(env.scene, env.simulation, env.config).robot_pixels()
    share = float(np.median(pixels)) / env.config.image_size**2
    return Check(
        "robot in the image",
        share >= MIN_ROBOT_SHARE,
        f"fills {100 * share:.1f} % of the image at its start (median)",
        f"Below {100 * MIN_ROBOT_SHARE:.0f} %: draw its geoms in group 0, 1 or 2, give them "
        "colours that differ from the floor's, or change camera_position_m and camera_look_at_m.",
    )


def _check_size(scene: Scene) -> Check:
    """Check that no part is far larger than the arm."""
    model = scene.model
    data = scene.at(scene.home)
    length = polyline_m([*data.xanchor, data.site_xpos[scene.tcp_site]])
    radii = np.where(robot_parts(scene), model.geom_rbound, 0.0)
    diameter = 2 * radii.max()
    largest = model.body(model.geom_bodyid[radii.argmax()])
    body = largest.name.removeprefix(ROBOT_PREFIX)
    return Check(
        "size of the robot",
        bool(diameter <= MAX_PART * length),
        f"the largest geom, of body {body!r}, has a diameter of {diameter:.3g} m; the arm "
        f"is {length:.3g} m long from its first joint",
        f"More than {MAX_PART:.0f} times the arm: a mesh in millimetres needs "
        'scale="0.001 0.001 0.001".',
    )


def _check_gripper(env: ArmVectorEnv) -> Check:
    """Check that at home the approach axis points down or ahead, not up."""
    position = env.simulation.tcp_position.mean(axis=0)
    approach = env.simulation.tcp_matrix[:, 2::3].mean(axis=0)
    above = position[2] > env.scene.robot.support_height_m
    return Check(
        "gripper",
        bool(above and approach[2] < 0.5),
        f"starts at {np.round(position, 3).tolist()} m, approach (z) is "
        f"{np.round(approach, 2).tolist()}",
        "The gripper should start above the support, its site's z axis pointing out of the "
        "fingers: change home, tcp_site, or tcp_quaternion.",
    )


def check_ways(config: EnvConfig) -> Iterator[Check]:
    """Check the reach of every target, and the oracle's path if all are reached."""
    is_reached = True
    for name in config.targets:
        env = ArmVectorEnv(replace(config, targets=(name,), image_size=1), SAMPLES)
        check = _check_reach(env)
        yield check
        is_reached &= check.ok
    if is_reached:
        yield next(check_agents(replace(config, image_size=1)))


def _check_reach(env: ArmVectorEnv, others: Sequence[str] = ()) -> Check:
    """Solve the inverse kinematics at positions over the whole rectangle."""
    scene = env.scene
    episodes = evaluation_episodes(env.config, SAMPLES, 1)
    env.reset(options={"episodes": episodes})
    solver = InverseKinematics.of_task(scene, env.running)
    position = env.running.goal_position
    goal = (position, env.running.goal_matrix)
    solution = solver.solve(*goal, env.joint_positions)
    path = StraightPath(scene, env.config, env.joint_positions, solution)
    reached = path.reached
    if reached.any():
        # The branch of the nearest place that is reached may also reach the others.
        nearest = cdist(position, position[reached]).argmin(axis=1)
        branch = solution.joints[reached][nearest]
        follow = InverseKinematics.of_task(scene, env.running, starts=1)
        again = path._replace(solution=follow.solve(*goal, branch, attempts=1))
        better = ~reached & again.reached
        for name, values in vars(solution).items():
            values[better] = getattr(again.solution, name)[better]
    remedy = "move or shrink the rectangle, turn the target with target_yaws_deg"
    if (path.steps > path.most_steps).any():
        remedy += f", enlarge mpi_rad, which is {scene.robot.mpi_rad:g}"
    if others:
        remedy += f", or leave it out: --targets {shlex.join(others)}"
    return check_reach(path, 0, episodes.position, f"{remedy}.")


class StraightPath(NamedTuple):
    """Straight paths of the joints, (n, J), to solutions for n places, as in episodes."""

    scene: Scene
    config: EnvConfig
    start: Floats
    solution: IKSolution

    @property
    def steps(self) -> Floats:
        """The number of largest steps, (n,)."""
        largest = joint_increments(self.scene.robot, self.config).max()
        change = np.abs(self.solution.joints - self.start).max(axis=1)
        return change / largest

    @property
    def most_steps(self) -> float:
        """The number in which a solution has to be reached."""
        return MOVING_SHARE * self.config.max_episode_steps

    @property
    def reached(self) -> Mask:
        """Which places are reached within the thresholds, without contact and in time, (n,)."""
        config = self.config
        thresholds = (config.success_distance_m, config.success_angle_deg)
        return self.solution.within(*thresholds) & (self.steps <= self.most_steps)


def check_agents(
    config: EnvConfig, distance_m: float = EVALUATION_M
) -> Iterator[Check]:
    """Play the oracle, whose path must be short enough to learn, and a fixed list of actions.

    The list is judged with the thresholds of an evaluation, whose distance is given [m], the oracle
    with those of a training: the same distance where it is smaller than the task's.
    """
    near_m = min(config.success_distance_m, distance_m)
    env = ArmVectorEnv(replace(config, success_distance_m=near_m), SAMPLES)
    oracle = play(OracleAgent(env), env, evaluation_episodes(config, SAMPLES, 2))
    share = oracle.success.mean()
    steps = float(np.percentile(oracle.length, 75))
    most = LEARNABLE_SHARE * config.max_episode_steps
    yield Check(
        "way to the grasps",
        bool(share >= MIN_ORACLE and steps <= most),
        f"inverse kinematics succeeds in {100 * share:.0f} % of {SAMPLES} episodes within "
        f"{100 * near_m:g} cm, three quarters of them within {steps:.0f} steps",
        f"At least {100 * MIN_ORACLE:.0f} % and at most {most:.0f} steps are learned well: change "
        "home or mpi_rad, or turn the targets (target_yaws_deg).",
    )
    blind, angle_deg = fixed_list_success(config, distance_m)
    yield Check(
        "without looking",
        blind <= MAX_BLIND,
        f"the best fixed list of actions solves {100 * blind:.0f} % within "
        f"{100 * distance_m:g} cm and {angle_deg:.0f} degrees",
        f"Above {100 * MAX_BLIND:.0f} % the task says little about vision: enlarge the rectangle, "
        "or check, train and evaluate with a smaller distance of success.",
    )


def fixed_list_success(config: EnvConfig, distance_m: float) -> tuple[float, float]:
    """Play the fixed list of actions that an evaluation plays, within a distance [m].

    Return the share of episodes that it solves, and the angle within which they count [deg].
    """
    angle_deg = max(EVALUATION_DEG, config.success_angle_deg)
    judged = replace(
        config, success_distance_m=distance_m, success_angle_deg=angle_deg, image_size=1
    )
    env = ArmVectorEnv(judged, SAMPLES)
    results = play(searched_list(env, 0), env, evaluation_episodes(config, SAMPLES, 2))
    return float(results.success.mean()), angle_deg


def check_reach(path: StraightPath, target: int, places: Floats, remedy: str) -> Check:
    """Check that episodes can reach solutions for a target at places (n, 2).

    The limits are the thresholds of success, no contact, and `MOVING_SHARE` of the steps.
    """
    robot = path.scene.robot
    name = path.scene.targets[target].name
    reached = path.reached
    share = float(reached.mean())
    where = ""
    if share < 1:
        missed = ~reached
        solution = path.solution
        x, y = places[missed].mean(axis=0)
        distance = np.median(solution.distance[missed])
        angle = np.median(solution.angle[missed])
        steps = np.median(path.steps[missed])
        where = (
            f"Not reached: positions around x {x:.2f}, y {y:.2f} m (median error {distance:.3f} m, "
            f"{angle:.0f} deg; {steps:.0f} steps of at most {path.most_steps:.0f}; "
            f"{100 * solution.contact[missed].mean():.0f} % in contact): {remedy}"
        )
    source = " (target_yaws_deg)" if object_of(name) in robot.target_yaws_deg else ""
    return Check(
        f"reach of {name}",
        share >= MIN_REACHABLE,
        f"{100 * share:.0f} % of {len(places)} positions reachable in time and without contact, at "
        f"a yaw of {robot.yaw_deg(name):.0f} degrees{source}",
        where,
    )


def _check_visible(env: ArmVectorEnv) -> Iterator[Check]:
    """Count the pixels in which the images with and without the target differ."""
    scene = env.scene
    images = SceneImages(scene, env.simulation, env.config)
    remedy = (
        "move the camera nearer or to the side (camera_position_m), narrow camera_fovy_deg, or "
        "choose a colour that differs from the support's."
    )
    (target,) = scene.targets
    for i, colour in enumerate(target.colours):
        shown = images.targets([0], i)
        yield check_visible(f"{colour} {target.name}", shown, images.empty, remedy)


def check_visible(name: str, shown: Images, empty: Images, remedy: str) -> Check:
    """Check the number of pixels in which images with an object differ from those without."""
    pixels = different_pixels(shown, empty)
    few = float(np.percentile(pixels, 5))
    return Check(
        f"{name} in the image",
        few >= MIN_PIXELS,
        f"in {np.median(pixels):.0f} pixels (median), {few:.0f} (5th percentile)",
        f"Fewer than {MIN_PIXELS}: {remedy}",
    )
