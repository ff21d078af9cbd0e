"""How often the right object is a candidate, and how often an agent asks, over training seeds.

Plays the splits, and S1 with a damaged graph, with agents that answer by a graph and ask where
there is not exactly one candidate. Prints a row per test and level: means in percent with 95 %
intervals over training seeds, and the values of the seeds.

    python -m benchmarks.unclear runs/irb120-choose-answers-distil/*

With --by-object it names all visible objects of new images instead, without an arm, and prints how
often the right name is a candidate: over all objects, for the object with the least, and the
standard deviation over objects, by one quantile for all objects and by one of each.

    python -m benchmarks.unclear zoo/irb120-choose-answers-fast --by-object --levels .9
"""

import argparse
from itertools import product
from pathlib import Path

import numpy as np

from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.evaluation import (
    AnyCondition,
    DamageTest,
    ReasoningTest,
    SplitTest,
)
from knowarm.experiment.load import load_agent
from knowarm.perception.calibration import (
    name_likelihoods,
    quantile,
    thresholds_of,
)
from knowarm.questions import number_objects
from knowarm.statistics import mean_of_runs

TESTS: dict[str, AnyCondition] = {
    **{split: SplitTest(split=split) for split in ("S1", "S2", "S3", "S4", "S5")},
    "S1, 30 % missing": DamageTest(damage="missing", share=0.3),
    "S1, 30 % wrong": DamageTest(damage="wrong", share=0.3),
}
NUMBERS = ("coverage", "questions", "choice")
IMAGE_SEEDS = range(1, 7)
"""Added to the training seed: the images of a thousand each, which no calibration draws."""


def by_object(run: Path, level: float) -> None:
    """Print how often the right name of a visible object is a candidate, by two quantiles."""
    trained = load_agent(run)
    network, env, seed = trained.network, trained.config.env, trained.config.seed
    if network is None:
        raise SystemExit("Give a run with a grounding network.")
    objects = number_objects(network.spec.facets)
    scores, facets = name_likelihoods(network, env, seed).values()
    of_all = np.full(len(objects), quantile(scores, level), np.float32)
    of_each = thresholds_of(scores, facets, objects, level)
    new = [name_likelihoods(network, env, seed + number) for number in IMAGE_SEEDS]
    found = np.concatenate([each["likelihoods"] for each in new])
    named = np.concatenate([each["facets"] for each in new])
    for name, thresholds in (("one for all", of_all), ("per object", of_each)):
        is_candidate = found >= thresholds[named]
        shares = [
            is_candidate[objects[named] == number].mean()
            for number in np.unique(objects[named])
        ]
        print(
            f"{run}, level {level:g}, {name}: {is_candidate.mean():.3f}, least of {len(shares)} "
            f"objects {min(shares):.2f}, standard deviation {np.std(shares):.3f}, "
            f"{len(found):,} objects in images"
        )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--levels", type=float, nargs="+", default=[0.8, 0.9])
    parser.add_argument("--episodes", type=int, default=500)
    parser.add_argument("--by-object", action="store_true")
    arguments = parser.parse_args()
    if arguments.by_object:
        for run, level in product(arguments.runs, arguments.levels):
            by_object(run, level)
        return
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
