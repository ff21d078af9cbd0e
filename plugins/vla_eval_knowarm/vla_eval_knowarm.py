"""Benchmark of vla-eval: the frozen episodes of KnowArm-Bench, or of a suite of one's own."""

from typing import Any, ClassVar

import numpy as np
from vla_eval.benchmarks.base import StepBenchmark, StepResult
from vla_eval.specs import IMAGE_RGB, LANGUAGE, STATE_JOINT, DimSpec

from knowarm import UserError
from knowarm.benchmark.suites import find_cells
from knowarm.world.config import scene_of
from knowarm.world.envs.single_env import ArmEnv

Values = dict[str, Any]


class KnowArmBenchmark(StepBenchmark):
    """Plays the cells of a suite, one task each; ``episode_idx`` is the number of the episode.

    Actions are joint targets (J,) [rad]; each joint takes the increment that ends nearest to its
    target. Images need no renderer of the system.

    Args:
        suite: SUITE or SUITE/CELL, with the beginning of a cell's name; SUITE may be the folder of
            `knowarm benchmark freeze`. All cells need the same joints.
    """

    render_backends: ClassVar[frozenset[str]] = frozenset({"gpu", "cpu"})

    def __init__(self, suite: str = "reach-v1/irb120") -> None:
        super().__init__()
        frozen, cells = find_cells(suite)
        self._suite = frozen.name
        self._cells = {cell.name: cell for cell in cells}
        by_joints: dict[tuple[str, ...], list[str]] = {}
        for cell in cells:
            joints = scene_of(cell.env).joint_names
            by_joints.setdefault(joints, []).append(f"{frozen.name}/{cell.name}")
        if len(by_joints) > 1:
            fitting = " or ".join(names[0] for names in by_joints.values())
            raise UserError(
                f"suite={suite!r} names cells of robots with different joints; name one robot's, "
                f"such as {fitting}."
            )
        self._joints = len(*by_joints)
        self._arm: ArmEnv | None = None

    @classmethod
    def configure_render(cls, mode: str) -> dict[str, str]:
        """Set nothing: images are computed on the CPU."""
        return {}

    def get_tasks(self) -> list[Values]:
        """Return a task per cell."""
        return [{"name": name, "suite": self._suite} for name in self._cells]

    def reset(self, task: Values) -> Values:
        """Start an episode of a cell."""
        cell = self._cells[task["name"]]
        options = vars(cell.env)
        if self._arm is None or self._arm.config != cell.env:
            self._arm = ArmEnv("rgb_array", observe=("image", "joints"), **options)
        number = task.get("episode_idx", 0) % len(cell.episodes)
        start = cell.episodes[number : number + 1]
        observation, _ = self._arm.reset(options={"episodes": start})
        return observation

    def step(self, action: Values) -> StepResult:
        """Move each joint towards its target.

        Raises:
            UserError: the action is not one finite number per joint.
        """
        arm = self._arm
        assert arm is not None  # of `reset`
        wanted = np.asarray(action["actions"], np.float64)
        if wanted.shape != (self._joints,) or not np.isfinite(wanted).all():
            raise UserError(
                f"An action must be {self._joints} finite numbers, got {wanted.tolist()}."
            )
        running = arm.vector.running
        scene = running.scene
        reached = arm.joint_targets[:, None] + running.increments
        lower = scene.joint_lower[:, None]
        upper = scene.joint_upper[:, None]
        levels = np.abs(reached.clip(lower, upper) - wanted[:, None]).argmin(1)
        observation, reward, terminated, truncated, info = arm.step(levels)
        return StepResult(observation, reward, terminated or truncated, info)

    def make_obs(self, raw_obs: Values, task: Values) -> Values:
        """Return image, joint angles and the goal in words."""
        assert self._arm is not None
        return {
            "images": {"policy": raw_obs["image"]},
            "state": raw_obs["joints"],
            "task_description": self._arm.instruction,
        }

    def get_step_result(self, step_result: StepResult) -> Values:
        """Return whether the episode succeeded."""
        return {"success": bool(step_result.info.get("is_success", False))}

    def get_action_spec(self) -> dict[str, DimSpec]:
        """Declare joint targets."""
        return {"joints": DimSpec("joints", self._joints, "absolute_joint_positions")}

    def get_observation_spec(self) -> dict[str, DimSpec]:
        """Declare image, joint angles and words."""
        return {"image": IMAGE_RGB, "state": STATE_JOINT, "language": LANGUAGE}

    def get_metadata(self) -> Values:
        """Return the steps of an episode, and the episodes of a cell."""
        cells = self._cells.values()
        return {
            "max_steps": max(cell.env.max_episode_steps for cell in cells),
            "max_episodes_per_task": min(len(cell.episodes) for cell in cells),
        }

    def get_hold_action(self, last_action: Values | None) -> Values:
        """Return the joint targets of the moment."""
        assert self._arm is not None
        return {"actions": self._arm.joint_targets}

    def render(self) -> Any:
        """Draw the policy's view, (480, 480, 3) uint8."""
        return None if self._arm is None else self._arm.render()
