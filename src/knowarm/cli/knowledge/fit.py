"""`knowarm knowledge fit`: a graph goes in; a trained graph embedding and its test come out."""

import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from knowarm.cli.tables import check_json_path, print_table, write_json_table
from knowarm.errors import UserError
from knowarm.knowledge import household, read_graph
from knowarm.knowledge.kge.config import KgeConfig
from knowarm.knowledge.kge.split import Split, split_graph
from knowarm.knowledge.read.openke import is_openke, read_openke_split

if TYPE_CHECKING:  # torch takes seconds to import, and the other commands do not need it
    from knowarm.knowledge.kge.train import Trained


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Train vectors for the entities of a graph, and test them by link prediction."""

    graph: Annotated[Path | None, tyro.conf.Positional] = None
    """A graph file, or an OpenKE folder, which brings its own split; left out, the shipped one."""
    training: Annotated[KgeConfig, tyro.conf.OmitArgPrefixes] = field(default_factory=KgeConfig)
    """The model and its training."""
    valid: float = 0.1
    """Share of triples to stop by, where the graph brings no split."""
    test: float = 0.1
    """Share of triples to test on, where the graph brings no split."""
    out: Path | None = None
    """Write the model: FILE.safetensors, which `embed --source FILE.safetensors` takes."""
    json: Path | None = None
    """Write `mrr`, `hits_at_10`, ... as JSON to this file."""

    def run(self) -> None:
        """Split, train, test and write."""
        from knowarm.knowledge.kge.rank import rank
        from knowarm.knowledge.kge.store import save_model

        check_json_path(self.json)
        if self.out is not None and self.out.suffix != ".safetensors":
            raise UserError(f"--out {self.out}: models are written as .safetensors.")
        split = read_split(self.graph, self.valid, self.test, self.training.seed)
        done = _train(self.training, split)
        found = rank(done.model, split.test, split.everything).describe()
        print_scores(self.training.model, split, found)
        print(f"Best of {done.epochs} epochs: {done.best_epoch}.")
        if self.out is not None:
            save_model(done.model, self.training, split.graph, self.out)
            print(f"Wrote {self.out}")
        values = {"model": self.training.model, **found, "epochs": done.best_epoch}
        write_json_table(self.json, {**values, "config": asdict(self.training)})


def read_split(path: Path | None, valid: float, test: float, seed: int) -> Split:
    """Return a graph's own split, or a random one.

    Raises:
        UserError: the graph cannot be read, or its own split has no test triple.
    """
    if path is None or not (path.is_dir() and is_openke(path)):
        graph = household() if path is None else read_graph(path)
        return split_graph(graph, valid=valid, test=test, seed=seed)
    split = read_openke_split(path)
    if not len(split.test):
        raise UserError(f"{path} has no test2id.txt with triples to test on. Add one.")
    return split


def print_scores(model: str, split: Split, found: dict[str, float]) -> None:
    """Print the measures of link prediction."""
    title = f"{model} on {split.graph}: {len(split.train)} training, {len(split.test)} test triples"
    print_table(title, ["measure", "value"], [(k, v) for k, v in found.items() if k != "triples"])


def _train(config: KgeConfig, split: Split) -> "Trained":
    """Train with a progress bar, or with plain lines when nobody watches."""
    from knowarm.knowledge.kge.train import train

    watched = sys.stdout.isatty()
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, disable=not watched, transient=True) as bar:
        task = bar.add_task(config.model, total=config.epochs)
        best = 0.0

        def on_epoch(epoch: int, loss: float, mrr: float | None) -> None:
            nonlocal best
            best = max(best, mrr or 0.0)
            text = f"{config.model}  loss {loss:.3f}  validation MRR {best:.3f}"
            bar.update(task, completed=epoch, description=text)
            if not watched and mrr is not None:
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
