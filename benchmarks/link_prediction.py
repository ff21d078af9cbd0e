"""Link prediction of KnowArm's embedding models and of PyKEEN's, on a made-up graph.

Both use the same split and 50 numbers per entity, and stop early on the validation triples.
PyKEEN runs with its defaults (sampled negatives, its loss, Adam at .001), for which it needs more
epochs; ANALOGY, which it lacks, is a custom interaction there.

    python -m benchmarks.link_prediction --json runs/bench/link_prediction.json
"""

import argparse
import gc
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.apartment_graph import apartment_graph
from knowarm.cli.tables import print_table
from knowarm.knowledge.kge import KgeConfig
from knowarm.knowledge.kge.models import MODELS
from knowarm.knowledge.kge.train import Split, rank, split_graph, train

DIM = 50


def ours(name: str, split: Split, seed: int) -> dict[str, float]:
    """Train and test one of our models with its defaults."""
    start = time.perf_counter()
    done = train(
        KgeConfig(model=name, dim=DIM, seed=seed), split.train, split.entities, split.relations,
        valid=split.valid, known=split.everything,
    )  # fmt: skip
    seconds = time.perf_counter() - start
    found = rank(done.model, split.test, split.everything)
    return {"mrr": found.mrr, "hits_at_10": found.hits_at(10), "seconds": seconds,
            "epochs": done.best_epoch}  # fmt: skip


def theirs(name: str, split: Split, seed: int, epochs: int) -> dict[str, float]:
    """Train and test PyKEEN's model of the same width with PyKEEN's defaults."""
    from pykeen.models import ERModel
    from pykeen.nn.modules import Interaction
    from pykeen.pipeline import pipeline
    from pykeen.triples import CoreTriplesFactory

    def factory(triples: np.ndarray) -> CoreTriplesFactory:
        return CoreTriplesFactory(
            torch.from_numpy(triples), num_entities=split.entities, num_relations=split.relations
        )

    class AnalogyInteraction(Interaction):
        """<h_s, r_s, t_s> + Re(<h_c, r_c, conj(t_c)>) on one real vector, as ours is laid out."""

        relation_shape = entity_shape = ("d",)

        def forward(self, h: torch.Tensor, r: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
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
        "hits_at_10": float(result.get_metric("both.realistic.hits_at_10")),
        "seconds": time.perf_counter() - start,
        "epochs": float(len(result.losses)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--models", nargs="+", default=list(MODELS))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--pykeen-epochs", type=int, default=2000)
    parser.add_argument("--skip-pykeen", action="store_true")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    graph = apartment_graph()
    split = split_graph(graph)
    rows, values = [], []
    for name in arguments.models:
        sides = {"KnowArm": [ours(name, split, seed) for seed in range(arguments.seeds)]}
        if not arguments.skip_pykeen:
            sides["PyKEEN"] = [
                theirs(name, split, seed, arguments.pykeen_epochs)
                for seed in range(arguments.seeds)
            ]
        for side, runs in sides.items():
            mean = {key: float(np.mean([run[key] for run in runs])) for key in runs[0]}
            spread = float(np.ptp([run["mrr"] for run in runs]))
            rows.append([name, side, mean["mrr"], spread, *list(mean.values())[1:]])
            values.append({"model": name, "side": side, **mean, "runs": runs})
            print(rows[-1], flush=True)
    title = f"Link prediction: {graph}, {len(split.test)} test triples, {arguments.seeds} seeds"
    columns = ["model", "library", "MRR", "MRR max-min", "Hits@10", "seconds", "epochs"]
    print_table(title, columns, rows)
    if arguments.json:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps({"title": title, "rows": values}, indent=2) + "\n")


if __name__ == "__main__":
    main()
