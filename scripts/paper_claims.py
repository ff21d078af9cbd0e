"""Sentences of the paper beside what the runs of `fast` say about them.

A sentence is a row: words, the paper's figure, the figure here, the verdict.
"""

from collections.abc import Sequence

import numpy as np

from knowarm.report.model import TaskData
from knowarm.report.pages.paper import published_result, time_saved
from knowarm.statistics import Interval
from scripts.answer_cells import CONTROLS, SIGNIFICANT, Cell, plus
from scripts.answer_outcomes import (
    Decided,
    effects,
    mean_success_row,
    published_f,
    seeds_apart,
    slower,
)

Row = list[str]


def fast_claims(cells: Sequence[Cell], known: Decided) -> list[Row]:
    """Return the rows of the sentences that runs of `fast` can judge."""
    tasks = [cell.task for cell in cells]
    return [
        *agent_claims(cells, "full", "Full knowledge"),
        *agent_claims(cells, "partial", "Partial knowledge"),
        randomized_claim(cells),
        content_claim(cells),
        mean_success_row(known),
        [
            "Analysis of variance over evaluation seeds shows its effect (5.4)",
            f"F {published_f(tasks)}; {effects(tasks)} points",
            f"two seeds of one agent: up to {seeds_apart(tasks):.1f} points apart",
            "[does not follow](answer.md#the-papers-analysis-of-variance)",
        ],
        [
            "No significant increase of computation (7)",
            "no figure",
            "`full`: {} to {} % of the steps per second of `bm`".format(*slower(tasks)),
            "[does not hold](answer-cells.md#cost-of-training)",
        ],
    ]


def agent_claims(cells: Sequence[Cell], name: str, words: str) -> list[Row]:
    """Return the sentences on learning time and final score of an agent with knowledge.

    The paper's figures are those of the cells that are decided here.
    """
    decided = [(cell, *pair) for cell in cells if (pair := cell.of(name, "bm"))]
    faster = [p < SIGNIFICANT and c.steps.high < 0 for _, c, p in decided]
    gains = [
        one["accuracy"] - other["accuracy"]
        for cell, *_ in decided
        if (one := published_result(cell.task, name))
        and (other := published_result(cell.task, "bm"))
    ]
    return [
        [
            f"{words} shortens learning (6)",
            f"{spread_of([saving(cell.task, name) for cell, *_ in decided])} % of the steps",
            f"{spread_of([-c.share.estimate for _, c, _ in decided])} % (intervals within "
            f"{widest([c.share for _, c, _ in decided])} %)",
            judged(faster),
        ],
        [
            f"{words} raises the final score (6)",
            f"{spread_of(gains)} points of accuracy",
            f"{spread_of([c.success.estimate for _, c, _ in decided], 1)} points of success",
            judged([c.success.low > 0 for _, c, _ in decided]),
        ],
    ]


def saving(task: TaskData, agent: str) -> float | None:
    """Return the share of the baseline's steps that an agent saved in the paper."""
    results = [published_result(task, name) for name in (agent, "bm")]
    if not all(results):
        return None
    return time_saved(*(each["best_step"] for each in results if each))


def spread_of(values: Sequence[float | None], digits: int = 0) -> str:
    """Format the range of numbers in percent."""
    known = [100 * value for value in values if value is not None]
    low, high = (plus(value, digits) for value in (min(known), max(known)))
    return low if low == high else f"{low} to {high}"


def widest(shares: Sequence[Interval]) -> str:
    """Format the range of the intervals of shares that are saved."""
    least = -100 * max(each.high for each in shares)
    most = -100 * min(each.low for each in shares)
    return f"{least:+.0f} and {most:+.0f}"


def judged(supported: Sequence[bool]) -> str:
    """Return a verdict from the cells that support a sentence."""
    count = sum(supported)
    if not count:
        return "not found"
    return f"found in {count} of {len(supported)} cells"


def randomized_claim(cells: Sequence[Cell]) -> Row:
    """Compare what full knowledge saves with randomized and with fixed colours."""
    by_robot: dict[str, dict[str, Cell]] = {}
    for cell in cells:
        robot, colours = cell.task.key
        by_robot.setdefault(robot, {})[colours] = cell
    published, gains, is_more = [], [], []
    for pair in by_robot.values():
        savings = [saving(pair[c].task, "full") or 0 for c in ("randomized", "fixed")]
        published.append(savings[0] - savings[1])
        shares = [pair[c].of("full", "bm") for c in ("randomized", "fixed")]
        one, other = (each[0].share for each in shares if each)
        gain = other.estimate - one.estimate
        half = np.hypot((one.high - one.low) / 2, (other.high - other.low) / 2)
        gains.append(gain)
        is_more.append(bool(gain > half))
    return [
        "It helps more where colours are randomized (6)",
        f"{spread_of(published)} points more of the steps",
        f"{spread_of(gains)} points",
        "not found" if not any(is_more) else f"found for {sum(is_more)} robots",
    ]


def content_claim(cells: Sequence[Cell]) -> Row:
    """Compare full knowledge with its controls."""
    decided = [
        pair for cell in cells for name in CONTROLS if (pair := cell.of("full", name))
    ]
    faster = sum(p < SIGNIFICANT and c.steps.high < 0 for c, p in decided)
    shares = spread_of([-c.share.estimate for c, _ in decided])
    count = len(decided)
    return [
        "What the knowledge says is the reason (6, 7)",
        "no control",
        f"{shares} % of the controls' steps in {count} comparisons",
        f"found in {faster} of {count} comparisons" if faster else "not found",
    ]
