"""Interface of an environment: what its observations hold, and what its actions mean."""

from typing import Any, Literal, get_args

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike

from knowarm.arrays import Array, Floats, Floats32, Images, Integers
from knowarm.errors import UserError, unknown_name
from knowarm.world.config import EnvConfig, facets_of
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.state import ACTION_LEVELS, NamedArrays

Action = Literal["levels", "continuous"]
"""Integers that index ``ACTION_LEVELS``; or joint steps in units of the MPI, -1 to 1."""

Observed = Literal["image", "joints", "knowledge"]
"""Image of the camera; angles of the joints [rad]; the knowledge vector of the episode."""

Observe = Literal["image"] | tuple[Observed, ...]
"""The image itself, or the parts of a ``Dict``."""


class Interface:
    """Spaces of one environment, and the conversion of observations and actions of n.

    Args:
        config: robot and task.
        scene: its J joints are those that the actions move.
        action: what an action is.
        observe: "image" for the image itself, or the names of the parts of a ``Dict``.
        knowledge: (R, K), one row per `Task.knowledge_rows`, where ``observe`` names "knowledge".

    Raises:
        UserError: an unknown name, or a table that is missing, of another shape, or not observed.
    """

    def __init__(
        self,
        config: EnvConfig,
        scene: Scene,
        action: Action = "levels",
        observe: Observe = "image",
        knowledge: ArrayLike | None = None,
    ) -> None:
        names: tuple[str, ...] = (
            (observe,) if isinstance(observe, str) else tuple(observe)
        )
        for name in names:
            _check_name("part of an observation", name, get_args(Observed))
        _check_name("kind of action", action, get_args(Action))
        self._names = names
        self._is_continuous = action == "continuous"
        self._table = _checked_table(config, names, knowledge)
        shape = (config.image_size, config.image_size, 3)
        joints = scene.num_joints
        # Contacts push joints beyond their limits.
        reach = scene.joint_upper - scene.joint_lower
        self._lower = (scene.joint_lower - reach).astype(np.float32)
        self._upper = (scene.joint_upper + reach).astype(np.float32)
        parts: dict[str, spaces.Space[Any]] = {
            "image": spaces.Box(0, 255, shape, np.uint8),
            "joints": spaces.Box(self._lower, self._upper, dtype=np.float32),
            "knowledge": spaces.Box(-np.inf, np.inf, self._table.shape[1:], np.float32),
        }
        self.observation_space: spaces.Space[Any] = parts["image"]
        if observe != "image":
            self.observation_space = spaces.Dict({name: parts[name] for name in names})
        levels = np.full(joints, len(ACTION_LEVELS))
        self.action_space: spaces.Space[Any] = spaces.MultiDiscrete(levels)
        if self._is_continuous:
            self.action_space = spaces.Box(-1.0, 1.0, (joints,), np.float32)

    def observe(self, images: Images, joints: Floats, rows: Integers) -> NamedArrays:
        """Return the named parts of n observations, (n, ...) each; ``rows`` of the table, (n,).

        Joints that are further beyond a limit than their range is wide are clipped to that.
        """
        angles = joints.astype(np.float32).clip(self._lower, self._upper)
        parts: NamedArrays = {"image": images, "joints": angles}
        if "knowledge" in self._names:
            parts["knowledge"] = self._table[rows]
        return {name: parts[name] for name in self._names}

    def steps(self, actions: ArrayLike, num_envs: int, increments: Floats) -> Floats:
        """Return the joint steps of actions (n, J) [rad], from the increments of the levels (7,).

        Raises:
            UserError: actions of the wrong shape or type, or out of range.
        """
        shape = (num_envs, *self.action_space.shape)  # type: ignore[misc]
        checked = _checked_actions(actions, shape, self._is_continuous)
        if self._is_continuous:
            return checked.astype(np.float64) * increments[1]
        return increments[checked]


def _check_name(what: str, name: str, allowed: tuple[str, ...]) -> None:
    """Check that a name is an allowed one."""
    if name not in allowed:
        raise unknown_name(what, name, allowed)


def _checked_table(
    config: EnvConfig, names: tuple[str, ...], knowledge: ArrayLike | None
) -> Floats32:
    """Return the knowledge table, (R, K); without rows where it is not observed."""
    if "knowledge" not in names:
        if knowledge is not None:
            raise UserError(
                "knowledge is a table that observations do not show; name it in observe, such as "
                "observe=('image', 'knowledge')."
            )
        return np.zeros((0, 0), np.float32)
    rows = config.task.asked.knowledge_rows(facets_of(config))
    if knowledge is None:
        knowledge = []
    table = np.asarray(knowledge, np.float32)
    if table.ndim != 2 or table.shape[0] != len(rows) or table.shape[1] == 0:
        raise UserError(
            f"knowledge must be a table with one row for each of the {len(rows)} values of the "
            f"info {config.task.asked.knowledge_info!r}, which begin with {rows[0]!r}; got shape "
            f"{table.shape}. Leave 'knowledge' out of observe to do without."
        )
    return table


def _checked_actions(
    actions: ArrayLike, shape: tuple[int, int], is_continuous: bool
) -> Array:
    """Return actions of a shape (n, J): numbers of levels, or continuous ones."""
    kinds = "iu"
    lowest = 0
    highest = len(ACTION_LEVELS) - 1
    allowed = f"integers from 0 to {highest}"
    if is_continuous:
        kinds = "f"
        lowest = -1
        highest = 1
        allowed = "floats from -1 to 1 (in units of the maximum position increment)"
    array = np.asarray(actions)
    if array.shape != shape or array.dtype.kind not in kinds:
        got = f"{array.dtype} of shape {array.shape}"
    elif not ((lowest <= array) & (array <= highest)).all():
        got = f"{array.min()} to {array.max()}"
    else:
        return array
    raise UserError(
        f"actions must be {allowed} of shape {shape} (environments, joints), got {got}."
    )
