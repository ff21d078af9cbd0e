"""`knowarm knowledge fit` and `evaluate`: train a graph embedding and test link prediction."""

import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from knowarm.cli.knowledge.options import GraphOptions
from knowarm.cli.tables import TableCommand, check_out, is_terminal, print_table
from knowarm.errors import UserError
from knowarm.knowledge.formats import SHIPPED
from knowarm.knowledge.formats.splits import is_split, read_split
from knowarm.knowledge.kge import KgeConfig

SILENT_S = 10.0
"""Time after which a training says how far it is [s]."""

if TYPE_CHECKING:
    from knowarm.knowledge.kge.train import Split


@dataclass(frozen=True, kw_only=True)
class SplitCommand(GraphOptions, TableCommand):
    """A command on a graph of which triples are held out; a folder may have its own split."""

    def split(self, seed: int, shares: dict[str, float]) -> "Split":
        """Return the graph's own split, or a random one."""
        from knowarm.knowledge.kge.train import split_graph  # imports torch, which takes seconds

        graph = self.graph
        if graph is None or graph in SHIPPED or not is_split(Path(graph)):
            return split_graph(self.read(), **shares, seed=seed)
        split = read_split(Path(graph))
        if not len(split.test):
            raise UserError(
                f"{self.graph} has no triples to test on. Add test.txt, or for OpenKE test2id.txt."
            )
        return split


@dataclass(frozen=True, kw_only=True)
class Fit(SplitCommand):
    """Train vectors for the entities of a graph, and test them by link prediction."""

    valid: float = 0.1
    """Share of triples for early stopping, where the graph has no split."""
    test: float = 0.1
    """Share of triples to test on, where the graph has no split."""
    training: Annotated[KgeConfig, tyro.conf.OmitArgPrefixes] = field(default_factory=KgeConfig)
    """The model and its training."""
    out: Path | None = None
    """Write the model: FILE.safetensors, for `embed --source FILE.safetensors`."""

    def result(self) -> dict[str, Any]:
        """Split, train with a line of progress that a terminal overwrites, test and write."""
        from knowarm.knowledge.kge.train import (
            save_model,  # imports torch, which takes seconds
            train,
        )

        check_out(self.out, "models", (".safetensors",))
        config, shares = self.training, {"valid": self.valid, "test": self.test}
        split = self.split(config.seed, shares)
        end = "\r" if is_terminal() else "\n"
        started = said = time.monotonic()
        latest = ""

        def on_epoch(epoch: int, loss: float, mrr: float | None) -> None:
            nonlocal said, latest
            now = time.monotonic()
            if mrr is not None:
                latest = f", validation MRR {mrr:.4f}"
            if mrr is not None or now - said > SILENT_S:
                left, said = (config.epochs - epoch) * (now - started) / epoch / 60, now
                line = f"epoch {epoch} of {config.epochs}: loss {loss:.4f}{latest}"
                print(f"{line}, at most {left:.1f} min left", end=end, flush=True)

        parts: dict[str, Any] = {"valid": split.valid, "known": split.everything}
        sizes = split.entities, split.relations
        done = train(config, split.train, *sizes, **parts, on_epoch=on_epoch)
        print(end="\n" if end == "\r" else "")
        scores = _print_scores(config.model, done.model, split)
        print(f"Best of {done.epochs} epochs: {done.best_epoch}.")
        if self.out is not None:
            save_model(done.model, config, split.graph, self.out, shares)
            print(f"Wrote {self.out}")
        return {**scores, "epochs": done.best_epoch, "config": asdict(config)}


@dataclass(frozen=True, kw_only=True)
class KnowledgeEvaluate(SplitCommand):
    """Test a model written by `fit --out` on the test triples of the graph it was fitted on."""

    model: Annotated[Path, tyro.conf.Positional]
    """The model's .safetensors file. It says which triples were held out."""

    def result(self) -> dict[str, Any]:
        """Load, rank and print."""
        from knowarm.knowledge.kge.train import load_model  # imports torch, which takes seconds

        stored = load_model(self.model)
        split = self.split(stored.config.seed, stored.shares)
        names = tuple(split.graph.names), tuple(split.graph.relation_names)
        if names != (stored.entities, stored.relations):
            raise UserError(
                f"{self.model} was fitted on another graph: it has {len(stored.entities)} entities "
                f"and {len(stored.relations)} relations, this graph {len(names[0])} and "
                f"{len(names[1])}, or their names differ. Give the graph it was fitted on."
            )
        return _print_scores(stored.config.model, stored.model, split)


def _print_scores(name: str, model: Any, split: "Split") -> dict[str, Any]:
    """Test a model by link prediction, print the measures and return them."""
    from knowarm.knowledge.kge.train import rank  # imports torch, which takes seconds

    scores = rank(model, split.test, split.everything).describe()
    sizes = f"{len(split.train):,} training and {len(split.test):,} test triples"
    rows = [each for each in scores.items() if each[0] != "triples"]
    print_table(f"Link prediction of {name}: {sizes}", ["measure", "value"], rows)
    return {"model": name, **scores}
