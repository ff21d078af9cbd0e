"""`knowarm knowledge show`: objects go in; subgraph, sentences and the vector's shape come out."""

from dataclasses import dataclass
from pathlib import Path

from knowarm.cli.knowledge.options import SceneOptions
from knowarm.cli.tables import check_json_path, print_table, write_json_table
from knowarm.knowledge import scene_embedding, scene_sentences, scene_subgraph
from knowarm.knowledge.term import local_name


@dataclass(frozen=True, kw_only=True)
class Show(SceneOptions):
    """Show what the graph says about objects, as sentences and as a vector."""

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
            f"source {config.source}, scope {config.scope}",
            ["slot", "numbers", "norm"],
            [
                [name, embedding.slot_dim, norm]
                for name, norm in zip(described["slots"], described["slot_norms"], strict=True)
            ],
        )
        coverage = described["coverage"]
        print(f"Labels found: {100 * coverage['share']:.0f} % of {coverage['labels']}.")
        if coverage["not_whole"]:
            print(f"Not or not wholly found: {', '.join(coverage['not_whole'])}.")
        if embedding.note:
            print(f"Note: {embedding.note}.")
        if embedding.constant:
            print("Every episode gets the same numbers: to the policy they are a bias.")
        if embedding.privileged:
            print("The numbers name the episode's object and colour: privileged information.")
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
