"""Drawing of episodes from streams of random numbers."""

import numpy as np

from knowarm.world.config import EnvConfig, setting_of
from knowarm.world.tasks.sampling import Episodes, Words, derive, uniforms

_FIRST = 4
"""Number of the task's first draws; those of joint offsets, looks, objects and skill follow."""


class EpisodeSource:
    """Draws the episodes of a config by stream and number (paper, table 1).

    The task draws the objects; the start joints are uniform within +-start_fraction of half their
    range around home.
    """

    def __init__(self, config: EnvConfig) -> None:
        setting = setting_of(config)
        scene = setting.scene
        robot = scene.robot
        self._joints = scene.num_joints
        self._look_draws = config.randomization.draws
        self._moved = np.isin(np.arange(scene.num_joints), robot.start_joints)
        self._reach = robot.start_fraction * (scene.joint_upper - scene.joint_lower) / 2
        self._objects = config.task.asked.sampler(setting)
        self._skill_draws = config.task.skill.draws
        self._names = np.array([target.name for target in scene.targets])

    def __call__(self, streams: Words, indices: Words) -> Episodes:
        """Draw n episodes; each depends only on its stream's seed and its number in it."""
        counts = (
            _FIRST,
            self._joints,
            self._look_draws,
            self._objects.draws,
            self._skill_draws,
        )
        u = uniforms(streams, indices, sum(counts))
        ends = np.cumsum(counts[:-1])
        first, joints, look, more, surroundings = np.split(u, ends, axis=1)
        drawn = self._objects(first, more)
        offsets = (2 * joints - 1) * self._reach
        return Episodes(
            joint_offsets=np.where(self._moved, offsets, 0.0),
            look=look,
            names=self._names[drawn.objects],
            surroundings=surroundings,
            **drawn._asdict(),
        )


def draw_episodes(config: EnvConfig, streams: Words, indices: Words) -> Episodes:
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
    streams = np.full(count, derive(seed, purpose), np.uint64)
    return draw_episodes(config, streams, np.arange(count, dtype=np.uint64))
