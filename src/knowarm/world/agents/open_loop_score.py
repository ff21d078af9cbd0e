"""Exact kinematics of many episodes that play the same list of actions; fast enough to search."""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from mujoco import mjtJoint
from numpy.linalg import norm

from knowarm.arrays import Floats, Integers, Mask
from knowarm.compiling import njit
from knowarm.world.config import EnvConfig, scene_of
from knowarm.world.envs.running import joint_increments
from knowarm.world.scene.compose import ROBOT_PREFIX
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.sampling import Episodes


class Chain(NamedTuple):
    """Kinematic chain of an arm with J joints."""

    lower: Floats  # Lower limit of each joint [rad] (slides: [m]), (J,)
    upper: Floats  # Upper limit of each joint, (J,)
    links: Floats  # Transforms before each joint, at angle 0, and to the gripper, (J + 1, 3, 4)
    slides: Mask  # Which joints slide along z; the others turn about z, (J,)
    # Number of the first joint from which all episodes have the same angles
    varied: int


class OpenLoopScore:
    """Exact kinematics of E episodes that play the same list of actions, T steps of J joints."""

    def __init__(self, config: EnvConfig, episodes: Episodes) -> None:
        scene = scene_of(config)
        self.scene = scene
        self.config = config
        self.increments = joint_increments(scene.robot, config)
        self.target = episodes.target
        start = scene.home + episodes.joint_offsets
        self.start = np.clip(start, scene.joint_lower, scene.joint_upper)
        varied = np.flatnonzero(np.ptp(self.start, axis=0) > 0)
        self._chain = _joint_chain(scene, int(varied.max(initial=-1)) + 1)
        self._goal = self.goals(episodes.target, episodes.position)

    def goals(self, target: Integers, position: Floats) -> Floats:
        """Return the goal frames of targets at places (k, 2) [m] as transforms, (k, 3, 4)."""
        skill = self.config.task.skill
        points, rotation = skill.goal_frames(self.scene, target, position)
        return np.concatenate([rotation.reshape(-1, 3, 3), points[..., None]], axis=2)

    def depends_on(self) -> tuple[object, ...]:
        """Return all that the score of a list of actions follows from: arrays and numbers."""
        config = self.config
        thresholds = (
            config.success_distance_m,
            config.success_angle_deg,
            config.ignore_roll,
        )
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
        if joints is None:
            joints = self.start
        if solved_at is None:
            solved_at = np.full(len(self.start), since)
        return _play(
            joints,
            self.increments[actions],
            self._chain,
            self._goal,
            config.success_distance_m,
            float(np.cos(np.radians(config.success_angle_deg))),
            config.ignore_roll,
            solved_at,
            since,
            config.max_episode_steps,
        )

    def is_solved(self, first: Integers) -> Mask:
        """Return which episodes a result of `play` solves, (E,)."""
        return first < self.config.max_episode_steps


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
    varied = chain.varied
    episodes, count = joints.shape
    steps = moves.shape[0]
    # Of the gripper; the angle is that of z alone, or of all
    first_axis = 2 if ignore_roll else 0
    end = joints.copy()
    same = joints[0].copy()
    cosines = np.empty(count)
    sines = np.empty(count)
    tail = np.empty((steps, 3, 4))
    for t in range(steps):
        tail[t] = chain.links[count]
        for j in range(varied, count):
            same[j] = _clipped(same[j] + moves[t, j], chain, j)
            cosines[j] = math.cos(same[j])
            sines[j] = math.sin(same[j])
        for c in range(4):
            _carry(tail[t, :, c], same, cosines, sines, chain, varied, count, c == 3)
    end[:, varied:] = same[varied:]
    move_cosines = np.cos(moves[:, :varied])
    move_sines = np.sin(moves[:, :varied])
    first = np.full(episodes, never)
    gripper = np.empty((3, 4))
    for e in range(episodes):
        is_solved = solved_at[e] < since
        if is_solved:
            first[e] = solved_at[e]
        for t in range(steps):
            for j in range(varied):
                angle = end[e, j] + moves[t, j]
                end[e, j] = _clipped(angle, chain, j)
                if t <= since or end[e, j] != angle:
                    if not is_solved and t >= since:
                        cosines[j] = math.cos(end[e, j])
                        sines[j] = math.sin(end[e, j])
                else:  # four products instead of cosine and sine
                    cos = cosines[j]
                    sin = sines[j]
                    cosines[j] = cos * move_cosines[t, j] - sin * move_sines[t, j]
                    sines[j] = sin * move_cosines[t, j] + cos * move_sines[t, j]
            if is_solved or t < since:
                continue
            gripper[:, 3] = tail[t, :, 3]
            _carry(gripper[:, 3], end[e], cosines, sines, chain, 0, varied, True)
            square = 0.0
            for k in range(3):
                square += (gripper[k, 3] - goal[e, k, 3]) ** 2
            if square >= distance_m**2:
                continue
            gripper[:, :3] = tail[t, :, :3]
            trace = 0.0
            for c in range(first_axis, 3):
                _carry(gripper[:, c], end[e], cosines, sines, chain, 0, varied, False)
                for k in range(3):
                    trace += gripper[k, c] * goal[e, k, c]
            aligned = trace if ignore_roll else (trace - 1) / 2
            if aligned > cosine:
                first[e] = t
                is_solved = True
    return first, end


@njit(cache=True, error_model="numpy", inline="always")
def _clipped(angle: float, chain: Chain, joint: int) -> float:
    """Clip the angle of a joint to its limits."""
    return min(max(angle, chain.lower[joint]), chain.upper[joint])


@njit(cache=True, error_model="numpy", inline="always")
def _carry(
    column: Floats,
    angles: Floats,
    cosines: Floats,
    sines: Floats,
    chain: Chain,
    first: int,
    after_last: int,
    is_point: bool,
) -> None:
    """Carry a column of a pose, in place, over some joints and the links before them."""
    for j in range(after_last - 1, first - 1, -1):
        x = column[0]
        y = column[1]
        z = column[2]
        if not chain.slides[j]:
            x = cosines[j] * column[0] - sines[j] * column[1]
            y = sines[j] * column[0] + cosines[j] * column[1]
        elif is_point:
            z += angles[j]
        link = chain.links[j]
        for k in range(3):
            column[k] = link[k, 0] * x + link[k, 1] * y + link[k, 2] * z
            if is_point:
                column[k] += link[k, 3]


def _joint_chain(scene: Scene, varied: int) -> Chain:
    """Split the arm into constant transforms with a turn about z, or a slide along z, between."""
    model = scene.model
    joints = [model.joint(ROBOT_PREFIX + name).id for name in scene.robot.joints]
    data = scene.at(np.zeros(scene.num_joints))
    tcp = np.eye(4)
    tcp[:3, :3] = data.site_xmat[scene.tcp_site].reshape(3, 3)
    tcp[:3, 3] = data.site_xpos[scene.tcp_site]
    axes = [_axis_frame(data.xanchor[joint], data.xaxis[joint]) for joint in joints]
    frames = [np.eye(4), *axes, tcp]
    links = [(np.linalg.inv(a) @ b)[:3] for a, b in pairwise(frames)]
    slides = model.jnt_type[joints] == mjtJoint.mjJNT_SLIDE
    return Chain(scene.joint_lower, scene.joint_upper, np.stack(links), slides, varied)


def _axis_frame(anchor: Floats, axis: Floats) -> Floats:
    """Build a frame (4, 4) at a joint's anchor with z along its axis."""
    side = np.eye(3)[np.argmin(np.abs(axis))]
    x = np.cross(side, axis)
    x /= norm(x)
    frame = np.eye(4)
    frame[:3, :3] = np.stack([x, np.cross(axis, x), axis], axis=1)
    frame[:3, 3] = anchor
    return frame
