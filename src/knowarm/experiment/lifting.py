"""Lift test of an evaluation: its columns of episodes, and their numbers."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from knowarm.statistics import wilson
from knowarm.world.agents.play import EpisodeResults
from knowarm.world.lifting.lift import OUTCOMES, lift
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.episodes import Episodes

NOT_REACHED = "not reached"
"""Outcome of episodes without success, in which nothing is lifted."""
EXCLUDED = "excluded"
"""Outcome of episodes whose object the robot's ``not_liftable`` names."""


def lift_columns(result: EpisodeResults, scene: Scene, episodes: Episodes) -> dict[str, np.ndarray]:
    """Lift the object of every successful episode; return ``lift`` and ``lift_rise_m``, (n,).

    Every episode ends at its first state within the thresholds, so each is lifted at most once.
    """
    count = len(episodes)
    names = np.array([target.name for target in scene.targets])[episodes.target]
    excluded = np.isin(names, list(scene.robot.not_liftable))
    chosen = np.flatnonzero(result.success & ~excluded)
    outcome = np.where(excluded, EXCLUDED, NOT_REACHED).astype("U16")
    rise = np.zeros(count)
    if len(chosen):
        steps = result.steps
        first = np.searchsorted(steps.episode, np.arange(count + 1))
        paths = [steps.joint_positions[first[i] : first[i + 1]] for i in chosen]
        lifts = lift(scene, paths, episodes.objects[chosen], episodes.positions[chosen])
        outcome[chosen], rise[chosen] = lifts.outcome, lifts.rise
    return {"lift": outcome, "lift_rise_m": rise}


def lift_numbers(episodes: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Compute the numbers of a group of episodes, without those that are excluded.

    ``lifted`` is the share of all episodes in which the object was lifted, ``grasps`` that of the
    successful ones, with 95 % Wilson intervals; ``lift_outcomes`` counts how lifts ended.
    """
    outcomes = episodes["lift"][episodes["lift"] != EXCLUDED]
    successes = np.count_nonzero(outcomes != NOT_REACHED)
    lifted = np.count_nonzero(outcomes == "lifted")
    values: dict[str, Any] = {"lift_episodes": len(outcomes)}
    for name, of in (("lifted", len(outcomes)), ("grasps", int(successes))):
        if of:
            values |= wilson(int(lifted), of).named(name)
    counted = {name: int(np.count_nonzero(outcomes == name)) for name in (*OUTCOMES, NOT_REACHED)}
    return values | {"lift_outcomes": counted}
