"""Answers of the graph without an arm: the object found in the first images of splits.

Takes the grounding network of a run and prints how often the grasp point that it predicts is
nearest to the wanted object's, per split: by the query's vector, by the graph's answers and by
controls of these. "perfect names" is what the answers are worth with a network that never errs:
one of the visible answers, or any object where none is visible. With --damage it damages the graph
that the agent knows, by kind and share, over several damage seeds; with --repair it is completed
by link prediction before it answers. With --confidence the agent also knows how doubtful each fact
is: calibrated probabilities that tell kept facts from damaged ones with an area under the ROC curve
of so much.

    python -m benchmarks.answers zoo/irb120-choose-subgraph-fast
    python -m benchmarks.answers zoo/irb120-choose-subgraph-fast --damage --splits S1 S2
    python -m benchmarks.answers answers/irb120-choose-answers-fast/* --damage --reasoning graph
    python -m benchmarks.answers zoo/*-choose-answers-fast --damage wrong --confidence .75 .9 1
"""

import argparse
import csv
import sys
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
import torch
from scipy.special import expit, logit
from scipy.stats import norm

from knowarm.config import override
from knowarm.experiment.evaluation import DamageTest, Subject
from knowarm.experiment.knows import Grounded, read_known_graph, reason_by
from knowarm.experiment.load import TrainedAgent, load_agent
from knowarm.experiment.other_graphs import target_names, with_graph
from knowarm.knowledge.config import KnowledgeConfig
from knowarm.knowledge.graph.builder import graph_of
from knowarm.knowledge.graph.damage import Damage
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.kge.models import MODELS
from knowarm.knowledge.queries.splits import SPLITS
from knowarm.perception.grounding import GroundingNetwork
from knowarm.perception.images import LabelledImages, sample_images
from knowarm.perception.recognition import AnswerGrounding, FrameRecognition
from knowarm.seeding import derive_seed
from knowarm.statistics import wilson
from knowarm.world.config import EnvConfig, facets_of

BATCH = 250
SHARES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
Task = tuple[EnvConfig, LabelledImages]


def network_of(trained: TrainedAgent) -> GroundingNetwork:
    """Return the agent's grounding network."""
    if trained.network is None:
        raise SystemExit("Give a run with a grounding network.")
    return trained.network


def right_object(
    trained: TrainedAgent, labels: LabelledImages, frames: torch.Tensor
) -> np.ndarray:
    """Return whether the grasp points of frames (n, 9) are nearest to the wanted object's."""
    network = network_of(trained)
    position = frames[:, :3] * network.position_std + network.position_mean
    distance = (labels.grasp_position - position[:, None]).norm(dim=2)
    return (distance.argmin(1) == 0).numpy()


def edited_graph(env: EnvConfig) -> KnowledgeGraph | None:
    """Return the edited graph of split S5."""
    graph: KnowledgeGraph | None = env.task.asked.edited_graph(facets_of(env))
    return graph


@torch.no_grad()
def measure(
    trained: TrainedAgent, task: Task, reasoning: Any, graph: KnowledgeGraph | None
) -> dict[str, np.ndarray]:
    """Return which images lead to the right object, by a reasoning and with perfect names.

    ``graph`` is what the agent knows instead of its own.
    """
    (env, labels), network = task, network_of(trained)
    config, seed = trained.config, trained.config.seed
    knows = reason_by(config.knows, reasoning, config.agent)
    if reasoning == "vector":
        described = knows.known(env, seed, graph=graph, trained=trained.config.env)
        known = FrameRecognition(network, described.table)
        frames = known(labels.images, labels.queries)
        return {"right": right_object(trained, labels, frames)}
    facets = network.spec.facets
    answers = cast(Grounded, knows).answers(
        env, seed, facets, graph=graph, reasoning=reasoning
    )
    known = AnswerGrounding(network, answers)
    parts = zip(labels.images.split(BATCH), labels.queries.split(BATCH), strict=True)
    seen = [known.see(images, known.of_rows(rows)) for images, rows in parts]
    visible = torch.cat([each.visible for each in seen]).numpy()
    shown = answers[labels.queries[:, None].numpy(), labels.facets.numpy()] > 0
    count = shown.sum(axis=1)
    guess = np.full(len(count), 1 / shown.shape[1])
    perfect = np.where(count > 0, shown[:, 0] / np.maximum(count, 1), guess)
    frames = torch.cat([each.frames for each in seen])
    return {
        "right": right_object(trained, labels, frames),
        "perfect": perfect,
        "sees_none": visible == 0,
        "sees_several": visible > 1,
    }


def percent(values: np.ndarray) -> str:
    """Return a share with its Wilson interval."""
    share = wilson(int(values.sum()), len(values))
    return f"{100 * values.mean():.1f} [{100 * share.low:.0f}, {100 * share.high:.0f}]"


def tasks_of(
    trained: TrainedAgent, splits: list[str], images: int, seed: int = 0
) -> dict[str, Task]:
    """Draw the first images of splits."""
    tasks: dict[str, Task] = {}
    for split in splits:
        env = trained.config.env
        env = replace(env, task=env.task.asking(split=split))
        stream = derive_seed(seed, "perception", list(SPLITS).index(split) + 1)
        tasks[split] = env, sample_images(env, network_of(trained).spec, images, stream)
    return tasks


def doubted(
    graph: KnowledgeGraph, env: EnvConfig, true: KnowledgeGraph, auc: float, seed: int
) -> KnowledgeGraph:
    """Return a damaged graph with a confidence of each fact, by a graph of the true ones.

    A score of each fact is drawn from one of two normal distributions, which overlap as the AUC
    says. The confidence is the probability that the fact is true, by its score and the share of
    true facts about the task's objects.
    """
    facts, known = [*graph], set(true)
    kept = np.array([fact in known for fact in facts])
    about = np.isin(graph.heads, [graph.entity_id(name) for name in target_names(env)])
    apart = np.sqrt(2) * norm.ppf(min(auc, 1 - 1e-9))
    noise = np.random.default_rng(derive_seed(seed, "damage", 3)).normal(size=len(kept))
    score = noise + np.where(kept, apart / 2, -apart / 2)
    confidence = expit(apart * score + logit(kept[about].mean())).tolist()
    return graph_of(
        facts,
        nodes=graph.entities,
        confidence=dict(zip(facts, confidence, strict=True)),
    )


def write_curves(runs: list[TrainedAgent], arguments: argparse.Namespace) -> None:
    """Write the curves of damaged graphs as CSV."""
    columns = [
        "robot",
        "agent",
        "training_seed",
        "split",
        "kind",
        "share",
        "damage_seed",
    ]
    rows = csv.writer(sys.stdout, lineterminator="\n")
    measured = ["right", "perfect_names", "sees_none"]
    rows.writerow([*columns, "reasoning", "repair", *measured, "confidence"])
    graphs: dict[
        tuple[object, ...], KnowledgeGraph | None
    ] = {}  # completing one takes seconds
    for trained in runs:
        config = trained.config
        tasks = tasks_of(trained, arguments.splits, arguments.images)
        seeds, repairs = range(arguments.damage_seeds), arguments.repair or [None]
        aucs = [None, *arguments.confidence]
        options = (
            arguments.damage,
            arguments.shares,
            seeds,
            arguments.reasoning,
            repairs,
            aucs,
        )
        for split, kind, share, seed, reasoning, repair, auc in product(
            tasks, *options
        ):
            if share == 0 and seed > 0 and repair is None:  # nothing is drawn
                continue
            damage = {"damage": kind, "share": share, "seed": seed, "repair": repair}
            env = tasks[split][0]
            key = (
                cast(KnowledgeConfig, config.knows).graph,
                env.targets,
                split == "S5",
                *damage.values(),
            )
            if key not in graphs:
                known = Subject(env=env, config=config, graph=edited_graph(env))
                graphs[key] = override(DamageTest(), damage).prepare(known).graph
            graph, true = (
                graphs[key],
                edited_graph(env) or read_known_graph(config.knows),
            )
            if auc is not None:
                assert graph is not None
                assert true is not None
                graph = doubted(graph, env, true, auc, seed)
            found = measure(trained, tasks[split], reasoning, graph)
            shares = [
                f"{found[name].mean():.4f}" if name in found else ""
                for name in ("right", "perfect", "sees_none")
            ]
            facts = [
                config.env.robot,
                config.agent,
                config.seed,
                split,
                kind,
                share,
                seed,
            ]
            rows.writerow(
                [*facts, reasoning, repair or "", *shares, "" if auc is None else auc]
            )
            sys.stdout.flush()


def main() -> None:
    """Print the table of splits, or write the curves of damaged graphs as CSV."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--splits", nargs="+", default=["S1", "S2", "S3", "S4", "S5"])
    parser.add_argument("--images", type=int, default=500)
    parser.add_argument("--reasoning", nargs="+", default=["vector", "graph"])
    kinds = get_args(Damage)
    parser.add_argument(
        "--damage", nargs="*", choices=kinds, help="kinds; none given: all"
    )
    parser.add_argument("--shares", type=float, nargs="+", default=SHARES)
    parser.add_argument(
        "--graph", help="another graph, asked all that it can be asked (S1)"
    )
    parser.add_argument(
        "--seeds", type=int, nargs="+", default=[0], help="of the images"
    )
    parser.add_argument("--damage-seeds", type=int, default=5)
    parser.add_argument("--repair", nargs="+", choices=sorted(MODELS))
    parser.add_argument(
        "--confidence", type=float, nargs="+", default=[], help="AUC, .5 to 1"
    )
    arguments = parser.parse_args()
    runs = [load_agent(run) for run in arguments.runs]
    if arguments.graph is not None:
        arguments.splits = ["S1"]
        runs = [
            replace(run, config=with_graph(run.config, arguments.graph)) for run in runs
        ]
    if arguments.damage is not None:
        arguments.damage = arguments.damage or kinds
        write_curves(runs, arguments)
        return
    for trained, seed in product(runs, arguments.seeds):
        for split, task in tasks_of(
            trained, arguments.splits, arguments.images, seed
        ).items():
            for reasoning in (*arguments.reasoning, "graph-shuffled", "colours"):
                found = measure(trained, task, reasoning, edited_graph(task[0]))
                run = (
                    trained.config.name,
                    trained.config.seed,
                    f"episodes {seed}",
                    split,
                )
                print(*run, reasoning, *(f"{n} {percent(v)}" for n, v in found.items()))


if __name__ == "__main__":
    main()
