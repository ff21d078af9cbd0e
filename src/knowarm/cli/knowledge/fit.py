"""`knowarm knowledge fit` and `evaluate`: train a graph embedding and test link prediction."""

import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from knowarm.cli.tables import check_json_path, print_table, write_json_table
from knowarm.errors import UserError
from knowarm.knowledge.formats import open_graph
from knowarm.knowledge.formats.openke import is_openke, read_openke_split
from knowarm.knowledge.kge import KgeConfig
from knowarm.knowledge.kge.split import Split, split_graph

if TYPE_CHECKING:  # imports torch, which takes seconds
    from knowarm.knowledge.kge.train import Trained


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Train vectors for the entities of a graph, and test them by link prediction."""

    graph: Annotated[Path | None, tyro.conf.Positional] = None
    """A graph file, or an OpenKE folder with its own split; the shipped graph by default."""
    training: Annotated[KgeConfig, tyro.conf.OmitArgPrefixes] = field(default_factory=KgeConfig)
    """The model and its training."""
    valid: float = 0.1
    """Share of triples for early stopping, where the graph has no split."""
    test: float = 0.1
    """Share of triples to test on, where the graph has no split."""
    out: Path | None = None
    """Write the model: FILE.safetensors, for `embed --source FILE.safetensors`."""
    json: Path | None = None
    """Write `mrr`, `hits_at_10`, ... as JSON to this file."""

    def run(self) -> None:
        """Split, train, test and write."""
        from knowarm.knowledge.kge.rank import rank
        from knowarm.knowledge.kge.store import save_model

        check_json_path(self.json)
        if self.out is not None and self.out.suffix != ".safetensors":
            raise UserError(f"--out {self.out}: models are written as .safetensors.")
        split = _read_split(self.graph, self.valid, self.test, self.training.seed)
        done = _train(self.training, split)
        found = rank(done.model, split.test, split.everything).describe()
        _print_scores(self.training.model, split, found)
        print(f"Best of {done.epochs} epochs: {done.best_epoch}.")
        if self.out is not None:
            save_model(done.model, self.training, split.graph, self.out)
            print(f"Wrote {self.out}")
        values = {"model": self.training.model, **found, "epochs": done.best_epoch}
        write_json_table(self.json, {**values, "config": asdict(self.training)})


@dataclass(frozen=True, kw_only=True)
class Evaluate:
    """Test a model written by `fit --out` on the test triples of its graph."""

    model: Annotated[Path, tyro.conf.Positional]
    """The model's .safetensors file."""
    graph: Annotated[Path | None, tyro.conf.Positional] = None
    """The graph it was fitted on; the shipped one by default."""
    valid: float = 0.1
    """As given to `fit`."""
    test: float = 0.1
    """As given to `fit`."""
    json: Path | None = None
    """Write `mrr`, `hits_at_10`, ... as JSON to this file."""

    def run(self) -> None:
        """Load, rank and print."""
        from knowarm.knowledge.kge.rank import rank  # imports torch
        from knowarm.knowledge.kge.store import load_model

        check_json_path(self.json)
        stored = load_model(self.model)
        split = _read_split(self.graph, self.valid, self.test, stored.config.seed)
        names = tuple(split.graph.names), tuple(split.graph.relation_names)
        if names != (stored.entities, stored.relations):
            raise UserError(
                f"{self.model} was fitted on another graph: it has {len(stored.entities)} entities "
                f"and {len(stored.relations)} relations, this graph {len(names[0])} and "
                f"{len(names[1])}, or their names differ. Give the graph it was fitted on."
            )
        found = rank(stored.model, split.test, split.everything).describe()
        _print_scores(stored.config.model, split, found)
        write_json_table(self.json, {"model": stored.config.model, **found})


def _read_split(path: Path | None, valid: float, test: float, seed: int) -> Split:
    """Return a graph's own split, or a random one.

    Raises:
        UserError: the graph cannot be read, or its own split has no test triple.
    """
    if path is None or not (path.is_dir() and is_openke(path)):
        graph = open_graph(path)
        return split_graph(graph, valid=valid, test=test, seed=seed)
    split = read_openke_split(path)
    if not len(split.test):
        raise UserError(f"{path} has no test2id.txt with triples to test on. Add one.")
    return split


def _print_scores(model: str, split: Split, found: dict[str, float]) -> None:
    """Print the measures of link prediction."""
    title = f"{model} on {split.graph}: {len(split.train)} training, {len(split.test)} test triples"
    print_table(title, ["measure", "value"], [(k, v) for k, v in found.items() if k != "triples"])


def _train(config: KgeConfig, split: Split) -> "Trained":
    """Train with a progress bar on a terminal, with plain lines elsewhere."""
    from knowarm.knowledge.kge.train import train

    terminal = sys.stdout.isatty()
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, disable=not terminal, transient=True) as bar:
        task = bar.add_task(config.model, total=config.epochs)
        best = 0.0

        def on_epoch(epoch: int, loss: float, mrr: float | None) -> None:
            nonlocal best
            best = max(best, mrr or 0.0)
            text = f"{config.model}  loss {loss:.3f}  validation MRR {best:.3f}"
            bar.update(task, completed=epoch, description=text)
            if not terminal and mrr is not None:
                print(f"epoch {epoch}: loss {loss:.4f}, validation MRR {mrr:.4f}")

        return train(
            config,
            split.train,
            split.entities,
            split.relations,
            valid=split.valid,
            known=split.everything,
            on_epoch=on_epoch,
        )
