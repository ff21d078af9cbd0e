"""How often the right object is a candidate, and how often an agent asks, over training seeds.

Plays the splits, and S1 with a damaged graph, with agents that answer by a graph and ask where
there is not exactly one candidate. Prints a row per test and level: means in percent with 95 %
intervals over training seeds, and the values of the seeds.

    python -m benchmarks.unclear runs/irb120-choose-answers-distil/*
"""

import argparse
from pathlib import Path

from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.evaluation import (
    AnyCondition,
    DamageTest,
    ReasoningTest,
    SplitTest,
)
from knowarm.experiment.load import load_agent
from knowarm.statistics import mean_of_runs

TESTS: dict[str, AnyCondition] = {
    **{split: SplitTest(split=split) for split in ("S1", "S2", "S3", "S4", "S5")},
    "S1, 30 % missing": DamageTest(damage="missing", share=0.3),
    "S1, 30 % wrong": DamageTest(damage="wrong", share=0.3),
}
NUMBERS = ("coverage", "questions", "choice")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--levels", type=float, nargs="+", default=[0.8, 0.9])
    parser.add_argument("--episodes", type=int, default=500)
    arguments = parser.parse_args()
    agents = [load_agent(run) for run in arguments.runs]
    for (name, test), level in (
        (t, v) for t in TESTS.items() for v in arguments.levels
    ):
        ask = ReasoningTest(unclear="ask", level=level)
        options = {"episodes": arguments.episodes, "test": (test, ask), "probes": ()}
        played = [evaluate(agent, write=False, **options) for agent in agents]
        cells = []
        for number in NUMBERS:
            values = [run.summary.interval(number) for run in played]
            found = mean_of_runs(values)
            low, high = 100 * found.low, 100 * found.high
            seeds = ", ".join(f"{100 * each.estimate:.1f}" for each in values)
            cells.append(
                f"{number} {100 * found.estimate:.1f} [{low:.1f}, {high:.1f}] ({seeds})"
            )
        print(f"{name}, level {level:g}:", "; ".join(cells), flush=True)


if __name__ == "__main__":
    main()
