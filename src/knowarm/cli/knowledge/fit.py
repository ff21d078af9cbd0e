"""`knowarm knowledge fit`: train vectors for the entities of a graph."""

import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes

from knowarm.cli.knowledge.options import GraphOptions
from knowarm.cli.tables import TableCommand, Values, check_out, is_terminal
from knowarm.knowledge.graph.denials import without_derived
from knowarm.knowledge.kge import KgeConfig

SILENT_S = 10.0
"""Time after which a training says how far it is [s]."""


@dataclass(frozen=True, kw_only=True)
class Fit(GraphOptions, TableCommand):
    """Train vectors for the entities of a graph."""

    valid: float = 0.1
    """Share of triples for early stopping."""
    training: Annotated[KgeConfig, OmitArgPrefixes] = field(default_factory=KgeConfig)
    """The model and its training."""
    out: Path | None = None
    """Write the model: FILE.safetensors, for `embed --source FILE.safetensors`."""

    def result(self) -> Values:
        """Split, train with a line of progress that a terminal overwrites, and write."""
        # They import torch, which takes seconds.
        from knowarm.knowledge.kge.train import hold_out, save_model, train

        check_out(self.out, "models", (".safetensors",))
        config = self.training
        graph = without_derived(self.read())
        triples, valid = hold_out(graph, self.valid, config.seed)
        end = "\r" if is_terminal() else "\n"
        started = time.monotonic()
        said = started
        latest = ""

        def on_epoch(epoch: int, loss: float, mrr: float | None) -> None:
            nonlocal said, latest
            now = time.monotonic()
            if mrr is not None:
                latest = f", validation MRR {mrr:.4f}"
            elif now - said <= SILENT_S:
                return
            said = now
            minutes_left = (config.epochs - epoch) * (now - started) / epoch / 60
            line = f"epoch {epoch} of {config.epochs}: loss {loss:.4f}{latest}"
            print(f"{line}, at most {minutes_left:.1f} min left", end=end, flush=True)

        trained = train(
            config,
            triples,
            len(graph.names),
            len(graph.relation_names),
            valid=valid,
            on_epoch=on_epoch,
        )
        print(end="\n" if end == "\r" else "")
        mrr = dict(trained.valid_mrr)[trained.best_epoch]
        print(
            f"Best of {trained.epochs} epochs: {trained.best_epoch}, validation MRR {mrr:.4f}."
        )
        if self.out is not None:
            save_model(trained.model, config, graph, self.out)
            print(f"Wrote {self.out}")
        return {
            "valid_mrr": mrr,
            "epochs": trained.best_epoch,
            "config": asdict(config),
        }
