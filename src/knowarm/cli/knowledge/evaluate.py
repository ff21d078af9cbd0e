"""`knowarm knowledge evaluate`: a fitted graph embedding goes in; its link prediction comes out."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from knowarm.cli.knowledge.fit import print_scores, read_split
from knowarm.cli.tables import check_json_path, write_json_table
from knowarm.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Evaluate:
    """Test a model that `fit --out` wrote on the test triples of its graph."""

    model: Annotated[Path, tyro.conf.Positional]
    """The model's .safetensors file."""
    graph: Annotated[Path | None, tyro.conf.Positional] = None
    """The graph that it was fitted on; left out, the shipped one."""
    valid: float = 0.1
    """As it was given to `fit`."""
    test: float = 0.1
    """As it was given to `fit`."""
    json: Path | None = None
    """Write `mrr`, `hits_at_10`, ... as JSON to this file."""

    def run(self) -> None:
        """Load, rank and print."""
        from knowarm.knowledge.kge.rank import rank  # torch takes seconds to import
        from knowarm.knowledge.kge.store import load_model

        check_json_path(self.json)
        stored = load_model(self.model)
        split = read_split(self.graph, self.valid, self.test, stored.config.seed)
        names = tuple(split.graph.names), tuple(split.graph.relation_names)
        if names != (stored.entities, stored.relations):
            raise UserError(
                f"{self.model} was fitted on another graph: it has {len(stored.entities)} entities "
                f"and {len(stored.relations)} relations, this graph {len(names[0])} and "
                f"{len(names[1])}, or their names differ. Name the graph it was fitted on."
            )
        found = rank(stored.model, split.test, split.everything).describe()
        print_scores(stored.config.model, split, found)
        write_json_table(self.json, {"model": stored.config.model, **found})
