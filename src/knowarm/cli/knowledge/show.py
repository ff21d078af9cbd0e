"""`knowarm knowledge show`: print the subgraph, sentences and embedding of objects."""

from dataclasses import dataclass
from pathlib import Path

from knowarm.cli.knowledge.options import SceneOptions
from knowarm.cli.tables import check_json_path, print_table, write_json_table
from knowarm.knowledge import scene_embedding, scene_sentences, scene_subgraph
from knowarm.knowledge.terms import local_name


@dataclass(frozen=True, kw_only=True)
class Show(SceneOptions):
    """Show the facts of the graph about objects, as triples, sentences and a vector."""

    json: Path | None = None
    """Write the same as JSON to this file."""

    def run(self) -> None:
        """Print the subgraph, the sentence of each slot, and the embedding's shape and norm."""
        check_json_path(self.json)
        config, facets = self.config(), self.facets()
        embedding = scene_embedding(config, facets)
        subgraph = scene_subgraph(config, facets)
        triples = list(subgraph)
        print_table(
            f"Subgraph: {len(triples)} triples, {len(subgraph.nodes)} entities",
            ["head", "relation", "tail"],
            [[local_name(name) for name in triple] for triple in triples],
        )
        sentences = scene_sentences(config, facets)
        print_table("Sentences", ["slot", "sentence"], sentences.items())
        described = embedding.describe()
        print_table(
            f"Embedding: shape ({embedding.dim},), norm {embedding.norm:.3f}, "
            f"source {config.source.short_name}, scope {config.scope}",
            ["slot", "numbers", "norm"],
            [
                [name, embedding.slot_dim, norm]
                for name, norm in zip(described["slots"], described["slot_norms"], strict=True)
            ],
        )
        coverage = described["coverage"]
        if coverage["labels"]:
            print(f"Labels found: {100 * coverage['share']:.0f} % of {coverage['labels']}.")
        if coverage["not_whole"]:
            print(f"Not found or found in part only: {', '.join(coverage['not_whole'])}.")
        if embedding.note:
            print(f"Note: {embedding.note}.")
        if embedding.constant:
            print("Every episode gets the same numbers, which act as a bias of the policy.")
        if embedding.privileged:
            print(
                "The numbers identify the object and colour of the episode: privileged information."
            )
        write_json_table(
            self.json,
            {
                "triples": triples,
                "entities": subgraph.entities,
                **described,
                "shape": [embedding.dim],
                "sentences": sentences,
                "vector": embedding.vector.tolist(),
            },
        )
