"""Link prediction of KnowArm's embedding models, on a folder of triples or beside PyKEEN's.

    python -m benchmarks.link_prediction --json runs/bench/link_prediction.json
    python -m benchmarks.link_prediction --graph FB15K237 --models complex --seeds 1 --dim 200

Without a folder, on a made-up graph: both libraries use the same split and 50 numbers per entity,
and stop early on the validation triples. PyKEEN runs with its defaults (sampled negatives, its
loss, Adam at .001), for which it needs more epochs; ANALOGY, which it lacks, is a custom
interaction there. TransE and DistMult are defined here: no agent uses them.
"""

import argparse
import gc
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.apartment_graph import apartment_graph
from benchmarks.triple_splits import Split, read_split, split_graph
from knowarm.cli.tables import print_table
from knowarm.knowledge.kge import KgeConfig
from knowarm.knowledge.kge.models import MODELS, KgeModel
from knowarm.knowledge.kge.train import filtered_ranks, train

DIM = 50


class TransE(KgeModel):
    """score(h, r, t) = -||h + r - t||_2 (Bordes et al. 2013, who also try the first norm)."""

    learning_rate = 0.003
    n3 = 0.0

    def query(self, head: torch.Tensor, relation: torch.Tensor) -> torch.Tensor:
        """Return h + r."""
        return head + relation

    def compare(self, query: torch.Tensor, tail: torch.Tensor) -> torch.Tensor:
        """Return the negative distances; Euclidean ones cost one matrix product."""
        return -torch.cdist(query, tail)


class DistMult(KgeModel):
    """score(h, r, t) = <h, r, t> = sum_i h_i r_i t_i (Yang et al. 2015)."""

    def query(self, head: torch.Tensor, relation: torch.Tensor) -> torch.Tensor:
        """Return h * r."""
        return head * relation


OWN_MODELS: dict[str, type[KgeModel]] = {"transe": TransE, "distmult": DistMult}
"""Models that only this benchmark has; `main` registers them."""

OPTIONS = {
    "dim": int,
    "epochs": int,
    "batch-size": int,
    "negatives": int,
    "learning-rate": float,
    "n3": float,
    "evaluate-every": int,
    "patience": int,
    "threads": int,
}
"""Fields of `KgeConfig` that are options of the command line, with their types."""


def summarize(ranks: np.ndarray) -> dict[str, float]:
    """Return the measures of filtered ranks (2 n,), for both directions and each alone."""
    tails, heads = np.split(ranks, 2)
    values = {"mrr": (1 / ranks).mean(), "mrr_tails": (1 / tails).mean()}
    values["mrr_heads"] = (1 / heads).mean()
    for k in (1, 3, 10):
        values[f"hits_at_{k}"] = (ranks <= k).mean()
    values["mean_rank"] = ranks.mean()
    return {name: float(value) for name, value in values.items()}


def ours(config: KgeConfig, split: Split) -> dict[str, float]:
    """Train and test one of our models."""
    start = time.perf_counter()
    done = train(
        config, split.train, split.entities, split.relations,
        valid=split.valid, known=split.everything,
    )  # fmt: skip
    seconds = time.perf_counter() - start
    scores = summarize(filtered_ranks(done.model, split.test, split.everything))
    return scores | {"seconds": seconds, "epochs": done.best_epoch}


def theirs(name: str, split: Split, seed: int, epochs: int) -> dict[str, float]:
    """Train and test PyKEEN's model of the same width with PyKEEN's defaults."""
    from pykeen.models import ERModel
    from pykeen.nn.modules import Interaction
    from pykeen.pipeline import pipeline
    from pykeen.triples import CoreTriplesFactory

    def factory(triples: np.ndarray) -> CoreTriplesFactory:
        return CoreTriplesFactory(
            torch.from_numpy(triples),
            num_entities=split.entities,
            num_relations=split.relations,
        )

    class AnalogyInteraction(Interaction):
        """<h_s, r_s, t_s> + Re(<h_c, r_c, conj(t_c)>) on one real vector, as ours is laid out."""

        relation_shape = entity_shape = ("d",)

        def forward(
            self, h: torch.Tensor, r: torch.Tensor, t: torch.Tensor
        ) -> torch.Tensor:
            pairs = h.shape[-1] // 4
            scalars = h.shape[-1] - 2 * pairs
            (hs, ha, hb), (rs, ra, rb), (ts, ta, tb) = (
                x.split([scalars, pairs, pairs], dim=-1) for x in (h, r, t)
            )
            real = (ha * ra - hb * rb) * ta + (ha * rb + hb * ra) * tb
            return (hs * rs * ts).sum(-1) + real.sum(-1)

    training = factory(split.train)
    model: dict[str, Any] = {"model": name, "model_kwargs": {"embedding_dim": DIM}}
    if name == "complex":
        model["model_kwargs"] = {"embedding_dim": DIM // 2}  # complex numbers
    if name == "analogy":
        interaction = AnalogyInteraction()
        model = {
            "model": ERModel(
                triples_factory=training, interaction=interaction, random_seed=seed,
                entity_representations_kwargs={"shape": DIM},
                relation_representations_kwargs={"shape": DIM},
            )
        }  # fmt: skip
    gc.collect()
    gc.freeze()  # PyKEEN collects garbage every epoch; without this a small graph takes minutes
    start = time.perf_counter()
    result = pipeline(
        training=training, validation=factory(split.valid), testing=factory(split.test),
        training_kwargs={"num_epochs": epochs, "use_tqdm": False},
        stopper="early", stopper_kwargs={"frequency": 50, "patience": 10,
                                         "metric": "inverse_harmonic_mean_rank"},
        evaluation_kwargs={"use_tqdm": False}, random_seed=seed, device="cpu", **model,
    )  # fmt: skip
    gc.unfreeze()
    return {
        "mrr": float(result.get_metric("both.realistic.inverse_harmonic_mean_rank")),
        "hits_at_1": float(result.get_metric("both.realistic.hits_at_1")),
        "hits_at_10": float(result.get_metric("both.realistic.hits_at_10")),
        "seconds": time.perf_counter() - start,
        "epochs": float(len(result.losses)),
    }


def main() -> None:
    MODELS.update(OWN_MODELS)
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--graph", type=Path, help="folder with its own split; leaves out PyKEEN"
    )
    parser.add_argument("--models", nargs="+", default=list(MODELS))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--pykeen-epochs", type=int, default=2000)
    parser.add_argument("--skip-pykeen", action="store_true")
    parser.add_argument("--json", type=Path)
    for name, kind in OPTIONS.items():
        parser.add_argument(f"--{name}", type=kind)
    arguments = parser.parse_args()
    options = {name.replace("-", "_") for name in OPTIONS}
    chosen = {name: value for name, value in vars(arguments).items() if name in options}
    chosen = {name: value for name, value in chosen.items() if value is not None}
    split = (
        split_graph(apartment_graph())
        if arguments.graph is None
        else read_split(arguments.graph)
    )
    rows, values = [], []
    for name in arguments.models:
        config = KgeConfig(model=name, **chosen)
        seeds = range(arguments.seeds)
        sides = {"KnowArm": [ours(replace(config, seed=seed), split) for seed in seeds]}
        if arguments.graph is None and not arguments.skip_pykeen:
            sides["PyKEEN"] = [
                theirs(name, split, seed, arguments.pykeen_epochs) for seed in seeds
            ]
        for side, runs in sides.items():
            mean = {key: float(np.mean([run[key] for run in runs])) for key in runs[0]}
            spread = float(np.ptp([run["mrr"] for run in runs]))
            columns = [
                mean[key]
                for key in ("mrr", "hits_at_1", "hits_at_10", "seconds", "epochs")
            ]
            rows.append([name, side, *columns, spread])
            values.append({"model": name, "side": side, **mean, "runs": runs})
            print(rows[-1], flush=True)
    title = (
        f"Link prediction: {split.graph}, {len(split.test)} test triples, "
        f"{arguments.seeds} seeds"
    )
    headings = [
        "model",
        "library",
        "MRR",
        "Hits@1",
        "Hits@10",
        "seconds",
        "epochs",
        "MRR max-min",
    ]
    print_table(title, headings, rows)
    if arguments.json:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(
            json.dumps({"title": title, "rows": values}, indent=2) + "\n"
        )


if __name__ == "__main__":
    main()
