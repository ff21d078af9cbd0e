"""Page `docs/results/answer-size.md` on the size of the network, without knowledge."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.stats import linregress, t

from knowarm.report.collect import collect
from knowarm.report.format import p_value
from knowarm.statistics import Interval, holm, welch
from scripts.answer_cells import (
    CONTROLS,
    SIGNIFICANT,
    Agent,
    Cell,
    cells_of,
    percent,
    signed,
    table,
    thousands,
    title_of,
)

TEXT = """**Protocol.** Study `size`: IRB120, randomized colours, no knowledge, training seeds
{seeds}; outcomes and comparisons were fixed before the runs. {progress} 278 and 428 are the sizes
of the paper's network with 150 and 300 numbers of knowledge. Speed: one core of an {processor},
median of {rounds} (`KNOWARM_CORES=1 python -m benchmarks.sizes`)."""


def speeds(path: Path) -> tuple[dict[str, list[float]], str]:
    """Return the measured steps per second by agent, and the processor."""
    lines = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
    found: dict[str, list[float]] = {}
    for line in lines:
        found.setdefault(line["agent"], []).append(float(line["steps_per_s"]))
    return found, lines[0]["processor"]


def slope(sizes: np.ndarray, values: np.ndarray) -> tuple[Interval, float]:
    """Return the change of values (n,) per doubling of the size (n,), and its p value."""
    line = linregress(np.log2(sizes), values)
    half = float(t.ppf(0.975, len(sizes) - 2)) * line.stderr
    return Interval(line.slope, line.slope - half, line.slope + half), float(
        line.pvalue
    )


LARGER_TEXT = """**Not settled by it.** All runs of the four controls of the [answer](answer.md),
which are as large as `full`, against `bm`, mean success during training [points]: {differences}
(Welch, not declared, p not corrected). New seeds have to confirm it."""


def larger_networks(cells: Sequence[Cell]) -> str:
    """Compare all runs of a cell's controls with its baseline, where all four ran."""
    parts = []
    for cell in cells:
        if not cell.agents.keys() >= CONTROLS.keys():
            continue
        areas = np.concatenate([cell.agents[name].area for name in CONTROLS])
        compared = welch(areas, cell.agents["bm"].area)
        parts.append(
            f"{signed(compared.difference, 100, 1)} with {len(areas)} runs against "
            f"{len(cell.agents['bm'].area)}, p {p_value(compared.p_value)} ({title_of(cell.task)})"
        )
    return LARGER_TEXT.format(differences="; ".join(parts))


def size_section(
    study: Path, speed: Path, progress: str, cells: Sequence[Cell]
) -> list[str]:
    """Return the blocks of the page.

    Args:
        study: unpacked study of sizes.
        speed: CSV file of the speeds of its agents.
        progress: how much of the study is done.
        cells: cells with controls of the size of `full`.
    """
    (cell,) = cells_of([collect([study])])
    task, agents = cell.task, cell.agents
    rates, processor = speeds(speed)
    parts = {group.name: group.runs[0] for group in task.groups}
    chosen = {name: run.config.policy for name, run in parts.items()}
    size_of = {
        n: p.hidden if isinstance(p.hidden, int) else p.features
        for n, p in chosen.items()
    }
    names = sorted(agents, key=size_of.__getitem__)
    base, rows = agents[names[0]], []
    for name in names:
        each, rate = agents[name], float(np.median(rates[name]))
        differs = name != names[0]
        rows.append(
            [
                *(f"`{name}`", str(size_of[name])),
                f"{parts[name].provenance.parameter_counts['total']:,}",
                thousands(each.steps),
                signed(welch(each.steps, base.steps).difference, 1e-3)
                if differs
                else "",
                *(percent(each.success), percent(each.area)),
                signed(welch(each.area, base.area).difference, 100, 1)
                if differs
                else "",
                f"{rate:,.0f}",
            ]
        )
    columns = [
        *("agent", "LSTM", "parameters", "steps to 80 % [thousands]", "against 128"),
        *(
            "success",
            "area",
            "against 128 [points]",
            "steps/s",
        ),
    ]
    sizes = np.concatenate(
        [[size_of[name]] * len(agents[name].seeds) for name in names]
    )
    steps, p_steps = slope(
        sizes, np.concatenate([agents[name].steps for name in names])
    )
    area, p_area = slope(sizes, np.concatenate([agents[name].area for name in names]))
    trend = (
        f"Per doubling of the LSTM the steps to 80 % change by {signed(steps, 1e-3)} thousand "
        f"(p {p_value(p_steps)}), the mean success during training by {signed(area, 100, 1)} "
        f"points (p {p_value(p_area)}), linear over {len(sizes)} runs, not corrected."
    )
    larger = [agents[name] for name in names[1:]]
    saved = [welch(each.steps, base.steps).difference for each in larger]
    gains = [welch(each.area, base.area) for each in larger]
    adjusted = holm([each.p_value for each in gains])[-1]
    later = seconds(larger[-1], base, rates)
    is_shown = (
        any(each.high < 0 for each in saved)
        or min(p_steps, p_area, adjusted) < SIGNIFICANT
    )
    assert not is_shown, "write the lead for what is found"
    lead = (
        f"**Not shown with {len(base.seeds)} seeds: that a size saves steps to 80 % over 128, or a "
        f"trend over the sizes. With {size_of[names[-1]]} mean success during training is "
        f"{signed(gains[-1].difference, 100, 1)} points higher (p {p_value(adjusted)} with Holm's "
        f"correction over {len(larger)} sizes), and by the clock 80 % comes "
        f"{later.estimate:,.0f} [{later.low:,.0f}, {later.high:,.0f}] seconds later.**"
    )
    text = TEXT.format(
        seeds=", ".join(map(str, base.seeds)),
        progress=progress,
        rounds=len(rates[names[0]]),
        processor=processor,
    )
    return [
        "# Is it the size of the network?",
        lead,
        larger_networks(cells),
        text,
        table(columns, rows),
        trend,
    ]


def seconds(first: Agent, second: Agent, rates: dict[str, list[float]]) -> Interval:
    """Return the difference of two agents in seconds to 80 %."""
    one, other = (each.steps / np.median(rates[each.name]) for each in (first, second))
    return welch(one, other).difference
