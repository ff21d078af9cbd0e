"""Drawing of episodes from streams of random numbers."""

import numpy as np
from numpy.typing import NDArray

from knowarm.world.config import EnvConfig, setting_of
from knowarm.world.tasks.sampling import Episodes, derive, uniforms

_JOINTS = 4
"""Number of the first draw of the joint offsets; those before it are the task's."""


class EpisodeSource:
    """Draws the episodes of a config by stream and number (paper, table 1).

    The task draws the objects; the start joints are uniform within +-start_fraction of half their
    range around home.
    """

    def __init__(self, config: EnvConfig) -> None:
        setting = setting_of(config)
        scene, robot = setting.scene, setting.scene.robot
        self._joints = scene.num_joints
        self._look_draws = config.randomization.draws
        self._moved = np.isin(np.arange(scene.num_joints), robot.start_joints)
        self._reach = robot.start_fraction * (scene.joint_upper - scene.joint_lower) / 2
        self._objects = config.task.sampler(setting)
        self._names = np.array([target.name for target in scene.targets])

    def __call__(self, streams: NDArray[np.uint64], indices: NDArray[np.uint64]) -> Episodes:
        """Draw n episodes; each depends only on its stream's seed and its number in it."""
        looks = _JOINTS + self._joints
        rest = looks + self._look_draws
        u = uniforms(streams, indices, rest + self._objects.draws)
        offsets = np.where(self._moved, (2 * u[:, _JOINTS:looks] - 1) * self._reach, 0.0)
        drawn = self._objects(u[:, :_JOINTS], u[:, rest:])
        names = self._names[drawn.objects]
        return Episodes(
            joint_offsets=offsets, look=u[:, looks:rest], names=names, **drawn._asdict()
        )


def draw_episodes(
    config: EnvConfig, streams: NDArray[np.uint64], indices: NDArray[np.uint64]
) -> Episodes:
    """Draw episodes of a config; see ``EpisodeSource``."""
    return EpisodeSource(config)(streams, indices)


def evaluation_episodes(
    config: EnvConfig, count: int, seed: int, purpose: str = "evaluation"
) -> Episodes:
    """Draw a fixed list of episodes, none of which is part of a training stream.

    Args:
        config: robot and task.
        count: number of episodes.
        seed: seed of the list; a shorter list is the beginning of a longer one.
        purpose: what it is played for; lists for others have other episodes.
    """
    streams = np.full(count, derive(seed, purpose), dtype=np.uint64)
    return draw_episodes(config, streams, np.arange(count, dtype=np.uint64))
