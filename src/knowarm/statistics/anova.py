"""Success rates over evaluation seeds go in; the paper's F and p come out, with their limits."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

WHAT_IT_SHOWS = (
    "Whether these trained networks differ, over random episodes. Every one of its observations "
    "comes from the same trained network, so it says nothing about what another training seed of "
    "the same method would give: with more evaluation seeds any two networks differ significantly."
)


@dataclass(frozen=True)
class Anova:
    """One-way analysis of variance.

    Attributes:
        f_value: variance between the networks over variance within.
        p_value: of equal means.
        freedom_between: networks minus one.
        freedom_within: observations minus networks.
    """

    f_value: float
    p_value: float
    freedom_between: int
    freedom_within: int


def one_way_anova(groups: Sequence[np.ndarray]) -> Anova:
    """The paper's test (section 5.3): 30 success rates a network, 100 episodes each.

    Args:
        groups: one (n_i,) array of success rates a trained network.

    Raises:
        ValueError: fewer than two groups, or fewer than two rates in one.
    """
    if len(groups) < 2 or min(len(group) for group in groups) < 2:
        raise ValueError("an analysis of variance needs two groups of two rates or more")
    total = sum(len(group) for group in groups)
    between, within = len(groups) - 1, total - len(groups)
    means = [float(np.mean(group)) for group in groups]
    if all(np.ptp(group) == 0 for group in groups):  # 0 / 0: no variance to compare with
        equal = len(set(means)) == 1
        return Anova(0.0 if equal else float("inf"), 1.0 if equal else 0.0, between, within)
    result = stats.f_oneway(*groups)
    return Anova(float(result.statistic), float(result.pvalue), between, within)
