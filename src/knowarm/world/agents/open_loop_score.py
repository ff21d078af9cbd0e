"""Exact kinematics of many episodes that play the same list of actions; fast enough to search."""

import math
from itertools import pairwise
from typing import NamedTuple

import mujoco
import numpy as np

from knowarm.arrays import Floats, Integers, Mask
from knowarm.compiling import njit
from knowarm.world.config import EnvConfig, scene_of
from knowarm.world.envs.running import joint_increments
from knowarm.world.scene.compose import ROBOT_PREFIX
from knowarm.world.scene.scene import Scene, target_places
from knowarm.world.tasks.sampling import Episodes


class Chain(NamedTuple):
    """Kinematic chain of an arm with J joints."""

    lower: Floats  # Lower limit of each joint [rad] (slides: [m]), (J,)
    upper: Floats  # Upper limit of each joint, (J,)
    links: Floats  # Transforms before each joint, at angle 0, and to the gripper, (J + 1, 3, 4)
    slides: Mask  # Which joints slide along z; the others turn about z, (J,)
    varied: int  # Number of the first joint from which all episodes have the same angles


class OpenLoopScore:
    """Exact kinematics of E episodes that play the same list of actions, T steps of J joints."""

    def __init__(self, config: EnvConfig, episodes: Episodes) -> None:
        self.scene = scene = scene_of(config)
        self.config = config
        self.increments = joint_increments(scene.robot, config)
        self.target = episodes.target
        start = scene.home + episodes.joint_offsets
        self.start = np.clip(start, scene.joint_lower, scene.joint_upper)
        varied = np.flatnonzero(np.ptp(self.start, axis=0) > 0)
        self._chain = _joint_chain(scene, int(varied[-1]) + 1 if len(varied) else 0)
        self._goal = self.goals(episodes.target, episodes.position)

    def goals(self, target: Integers, position: Floats) -> Floats:
        """Return the goal frames of targets at places (k, 2) [m] as transforms, (k, 3, 4)."""
        scene = self.scene
        points = target_places(scene, position) + scene.grasp_position[target]
        rotation = scene.grasp_matrix[target].reshape(-1, 9)
        points, rotation = self.config.task.goal(scene, target, points, rotation)
        return np.concatenate([rotation.reshape(-1, 3, 3), points[..., None]], axis=2)

    def depends_on(self) -> tuple[object, ...]:
        """Return all that the score of a list of actions follows from: arrays and numbers."""
        config = self.config
        thresholds = (config.success_distance_m, config.success_angle_deg, config.ignore_roll)
        arrays = (*self._chain, self.increments, self.start, self.target, self._goal)
        return (*arrays, thresholds, config.max_episode_steps)

    def play(
        self,
        actions: Integers,
        joints: Floats | None = None,
        solved_at: Integers | None = None,
        since: int = 0,
    ) -> tuple[Integers, Floats]:
        """Play actions (T, J) from joint angles (E, J) [rad], by default those at the start.

        Return the step that solves each episode, (E,), the time limit if none does, and the last
        joint angles. Episodes whose ``solved_at`` step, (E,), is before ``since`` keep it; in the
        others no step before ``since`` solves.
        """
        config = self.config
        return _play(
            self.start if joints is None else joints,
            self.increments[actions],
            self._chain,
            self._goal,
            config.success_distance_m,
            float(np.cos(np.radians(config.success_angle_deg))),
            config.ignore_roll,
            np.full(len(self.start), since) if solved_at is None else solved_at,
            since,
            config.max_episode_steps,
        )

    def is_solved(self, first: Integers) -> Mask:
        """Return which episodes a result of `play` solves, (E,)."""
        return np.asarray(first < self.config.max_episode_steps)


@njit(cache=True, error_model="numpy")
def _play(
    joints: Floats,
    moves: Floats,
    chain: Chain,
    goal: Floats,
    distance_m: float,
    cosine: float,
    ignore_roll: bool,
    solved_at: Integers,
    since: int,
    never: int,
) -> tuple[Integers, Floats]:
    """Kernel of ``OpenLoopScore``.

    Joints from number ``varied`` on have the same angles in every episode: their part of the chain
    is computed once per step. Angles come last, as most gripper positions are too far away.
    """
    lower, upper, links, slides, varied = chain
    episodes, count = joints.shape
    steps = moves.shape[0]
    end = joints.copy()
    same = joints[0].copy()
    tail = np.empty((steps, 3, 4))
    for t in range(steps):
        tail[t] = links[count]
        for j in range(count - 1, varied - 1, -1):
            same[j] = min(max(same[j] + moves[t, j], lower[j]), upper[j])
            cos, sin = math.cos(same[j]), math.sin(same[j])
            for c in range(4):
                _carry(tail[t, :, c], same[j], cos, sin, slides[j], links[j], c == 3)
    end[:, varied:] = same[varied:]
    move_cos, move_sin = np.cos(moves[:, :varied]), np.sin(moves[:, :varied])
    cosines, sines = np.empty(varied), np.empty(varied)
    first = np.full(episodes, never)
    gripper = np.empty((3, 4))
    for e in range(episodes):
        done = solved_at[e] < since
        if done:
            first[e] = solved_at[e]
        for t in range(steps):
            for j in range(varied):
                angle = end[e, j] + moves[t, j]
                end[e, j] = min(max(angle, lower[j]), upper[j])
                if t <= since or end[e, j] != angle:
                    if not done and t >= since:
                        cosines[j], sines[j] = math.cos(end[e, j]), math.sin(end[e, j])
                else:  # four products instead of cosine and sine
                    cos, sin = cosines[j], sines[j]
                    cosines[j] = cos * move_cos[t, j] - sin * move_sin[t, j]
                    sines[j] = sin * move_cos[t, j] + cos * move_sin[t, j]
            if done or t < since:
                continue
            square = 0.0
            gripper[:, 3] = tail[t, :, 3]
            for j in range(varied - 1, -1, -1):
                _carry(gripper[:, 3], end[e, j], cosines[j], sines[j], slides[j], links[j], True)
            for k in range(3):
                square += (gripper[k, 3] - goal[e, k, 3]) ** 2
            if square >= distance_m**2:
                continue
            gripper[:, :3] = tail[t, :, :3]
            for c in range(2 if ignore_roll else 0, 3):
                for j in range(varied - 1, -1, -1):
                    _carry(
                        gripper[:, c], end[e, j], cosines[j], sines[j], slides[j], links[j], False
                    )
            trace = 0.0
            for c in range(2 if ignore_roll else 0, 3):
                for k in range(3):
                    trace += gripper[k, c] * goal[e, k, c]
            if (trace if ignore_roll else (trace - 1) / 2) > cosine:
                first[e] = t
                done = True
    return first, end


@njit(cache=True, error_model="numpy", inline="always")
def _carry(
    column: Floats, value: float, cos: float, sin: float, slide: bool, link: Floats, is_point: bool
) -> None:
    """Carry a column of a pose, in place, over one joint and the link before it."""
    x, y, z = column[0], column[1], column[2]
    if slide:
        z += value if is_point else 0.0
    else:
        x, y = cos * x - sin * y, sin * x + cos * y
    shift = 1.0 if is_point else 0.0
    for k in range(3):
        column[k] = link[k, 0] * x + link[k, 1] * y + link[k, 2] * z + link[k, 3] * shift


def _joint_chain(scene: Scene, varied: int) -> Chain:
    """Split the arm into constant transforms with a turn about z, or a slide along z, between."""
    model = scene.model
    joints = [model.joint(ROBOT_PREFIX + name).id for name in scene.robot.joints]
    data = scene.at(np.zeros(scene.num_joints))
    tcp = np.eye(4)
    tcp[:3, :3] = data.site_xmat[scene.tcp_site].reshape(3, 3)
    tcp[:3, 3] = data.site_xpos[scene.tcp_site]
    frames = [np.eye(4), *(_axis_frame(data.xanchor[j], data.xaxis[j]) for j in joints), tcp]
    links = [(np.linalg.inv(a) @ b)[:3] for a, b in pairwise(frames)]
    slides = model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_SLIDE
    return Chain(scene.joint_lower, scene.joint_upper, np.stack(links), slides, varied)


def _axis_frame(anchor: Floats, axis: Floats) -> Floats:
    """Build a frame (4, 4) at a joint's anchor with z along its axis."""
    side = np.eye(3)[np.argmin(np.abs(axis))]
    x = np.cross(side, axis)
    x /= np.linalg.norm(x)
    frame = np.eye(4)
    frame[:3, :3] = np.stack([x, np.cross(axis, x), axis], axis=1)
    frame[:3, 3] = anchor
    return frame
