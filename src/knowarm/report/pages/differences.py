"""Page "Differences": statistical comparisons of agents, over training seeds and the paper's."""

from collections.abc import Callable

import numpy as np

from knowarm.arrays import Floats
from knowarm.errors import UserError
from knowarm.report.blocks import (
    Block,
    DataTable,
    Figure,
    Row,
    Verdict,
    row_of,
    table_of,
)
from knowarm.report.charts import SUCCESS_AXIS, Series, near, percent_axis
from knowarm.report.model import Group, TaskData
from knowarm.report.pages.knowledge import claim_row, forest_figure
from knowarm.report.pages.paper import published_comparison
from knowarm.report.pages.training import line_figure, line_rows
from knowarm.report.verdicts.claims import (
    ALPHA,
    FEW_SEEDS,
    FEWEST_SEEDS,
    OUTCOMES,
    Claim,
    Claims,
    pairs,
    scores,
)
from knowarm.statistics import (
    Interval,
    bootstrap,
    iqm,
    one_way_anova,
    performance_profile,
    probability_of_improvement,
    seeds_needed,
)

EXPLANATION = (
    "A method is a procedure for training networks; one observation of a method is one training "
    "seed. A thousand evaluation episodes measure one network precisely and say nothing about the "
    "next network that the same procedure trains.",
    "Two outcomes are tested: success after training and mean success during training. Means are "
    "compared with Welch's t test over training seeds. Each agent whose knowledge is tested is "
    "first compared with the baseline, with Holm's correction over all tasks and outcomes of the "
    "report. Only if that difference is significant is it compared with the controls, and a "
    "question is answered only when every control of its kind is beaten. Significant means an "
    f"adjusted p of at most {ALPHA} and at least {FEWEST_SEEDS} seeds of each agent. Of studies "
    "without any effect, at most one in twenty reports a false claim.",
    "Everything else on this page is descriptive: interquartile means, bootstrap intervals (too "
    "narrow below about ten seeds), the probability that one run beats another.",
)

PROFILE_LEVELS = np.linspace(0, 1, 101)  # of success, of the performance profile
FEWEST_RATES = 5  # evaluation seeds below which the analysis of variance is not shown


def difference_blocks(task: TaskData, decided: Claims) -> list[Block]:
    """Show the statistics over training seeds and the paper's, each with what it tests."""
    if len(task.groups) < 2:
        return []
    blocks = (
        _comparisons(task, decided),
        _scores(task),
        _profile(task),
        _variance(task),
    )
    return [block for block in blocks if block]


def _comparisons(task: TaskData, decided: Claims) -> Block:
    """Show every difference that the report decides on."""
    claims = [claim for claim in decided if claim.task is task]
    if not any(claim.comparison for claim in claims):
        return Verdict("No differences are computed from single seeds.", [FEW_SEEDS])
    rows = [_comparison_row(claim) for claim in claims]
    return forest_figure(table_of(task, "comparisons", rows))


def _comparison_row(claim: Claim) -> Row:
    outcome = OUTCOMES[claim.outcome]
    row = claim_row(claim, outcome) | {
        "outcome": outcome,
        "first": claim.first.name,
        "second": claim.against,
        "seeds": str(claim.seeds),
    }
    compared = claim.comparison
    if compared:
        row |= {
            "seeds": f"{compared.first_count} / {compared.second_count}",
            "effect_size": compared.effect_size,
            "p": compared.p_value,
        }
        if compared.effect_size and claim.verdict not in ("better", "worse"):
            row["needed"] = seeds_needed(compared.effect_size)
    return row


def _scores(task: TaskData) -> DataTable:
    """Show the success of each agent over training seeds; a single seed has no interval."""
    baseline = task.baseline or task.groups[0]
    base = scores(task, baseline, "success")
    rows = []
    for group in task.groups:
        final = scores(task, group, "success")
        row = row_of(group) | {
            "seeds": len(final),
            "mean": _with_interval(final, np.mean),
            "iqm": _with_interval(final, iqm),
            "area": _with_interval(scores(task, group, "speed"), np.mean),
        }
        if group is not baseline and min(final.size, base.size) > 1:
            row["improvement"] = probability_of_improvement(final, base)
        rows.append(row)
    return table_of(task, "scores", rows, baseline=baseline.name)


def _with_interval(
    values: Floats, statistic: Callable[..., Floats]
) -> Interval | float | None:
    """Return a statistic of several values with its interval, and a single value as it is."""
    if values.size > 1:
        return bootstrap(values, statistic)
    return float(values[0]) if values.size else None


def _profile(task: TaskData) -> Figure | None:
    """Draw performance profiles of agents with enough seeds."""
    finals = {}
    for group in task.groups:
        final = scores(task, group, "success")
        if final.size >= FEWEST_SEEDS:
            finals[group] = final
    if not finals:
        return None
    axis = near(SUCCESS_AXIS, np.concatenate([*finals.values()]).tolist())
    start, _ = axis.range or (0.0, 1.0)
    levels = PROFILE_LEVELS[start <= PROFILE_LEVELS]
    lines = []
    for group, final in finals.items():
        share, low, high = performance_profile(final, levels)
        line = Series(
            name=group.name,
            colour=group.colour,
            x=levels,
            y=share,
            band=(low, high),
            stairs=True,
        )
        lines.append(line)
    rows = line_rows({"share": lines}, "level")
    table = table_of(task, "profile", rows)
    axes = {"share": percent_axis("runs above")}
    return line_figure(table, {"share": lines}, axis, axes)


def _variance(task: TaskData) -> DataTable | None:
    """Run the paper's one-way ANOVA (section 5.3) on success rates over evaluation seeds."""
    rows = []
    for first, second, _ in pairs(task):
        rates = success_rates(first)
        other_rates = success_rates(second)
        if rates is None or other_rates is None:
            continue
        f_value, p_value = one_way_anova([rates, other_rates])
        row = {
            "first": first.name,
            "second": second.name,
            "rates": len(rates),
            "first_mean": rates.mean(),
            "second_mean": other_rates.mean(),
            "f": round(f_value, 2),
            "p": p_value,
            "paper_f": published_comparison(task, first, second).get("anova_f"),
        }
        rows.append(row)
    if not rows:
        return None
    return table_of(task, "anova", rows)


def success_rates(group: Group) -> Floats | None:
    """Return the success rate per evaluation seed of the best run, where there are enough seeds."""
    if group.best_run is None:
        return None
    for evaluation in group.best_run.evaluations.values():
        if evaluation.summary.config.seeds < FEWEST_RATES:
            continue
        try:
            episodes = evaluation.episodes()
        except UserError:
            continue
        seeds = episodes["evaluation_seed"]
        rates = [episodes["success"][seeds == seed].mean() for seed in np.unique(seeds)]
        return np.array(rates) if len(rates) > 1 else None
    return None
