"""`knowarm knowledge show`, `embed` and `probe`: sentences and vectors of a scene's objects."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import save_file

from knowarm.cli.knowledge.options import SceneOptions
from knowarm.cli.tables import check_out, print_table
from knowarm.config import to_dict
from knowarm.knowledge import SceneEmbedding, scene_embedding, scene_sentences, scene_subgraph
from knowarm.knowledge.graph.terms import local_name
from knowarm.knowledge.probe import NEARLY_SAME, probe
from knowarm.reading import replacing


@dataclass(frozen=True, kw_only=True)
class KnowledgeShow(SceneOptions):
    """Show the facts of the graph about objects, as triples, sentences and a vector."""

    def result(self) -> dict[str, Any]:
        """Print the subgraph, the sentence of each slot, and the embedding's shape and norm."""
        config, facets = self.config(), self.facets()
        seed = self.run_seed()
        embedding = scene_embedding(config, facets, run_seed=seed)
        subgraph = scene_subgraph(config, facets, run_seed=seed)
        triples = list(subgraph)
        title = f"Subgraph: {len(triples)} triples, {len(subgraph.nodes)} entities"
        facts = [[local_name(name) for name in triple] for triple in triples]
        print_table(title, ["head", "relation", "tail"], facts)
        sentences = scene_sentences(config, facets, run_seed=seed)
        print_table("Sentences", ["slot", "sentence"], sentences.items())
        described = embedding.describe()
        norms = zip(described.slots, described.slot_norms, strict=True)
        title = f"Embedding: shape ({embedding.dim},), norm {embedding.norm:.3f}, "
        title += f"source {config.source.short_name}, scope {config.scope}"
        rows = [[name, embedding.slot_dim, norm] for name, norm in norms]
        print_table(title, ["slot", "numbers", "norm"], rows)
        coverage = described.coverage
        if coverage["labels"]:
            print(f"Labels found: {100 * coverage['share']:.0f} % of {coverage['labels']}.")
        if coverage["not_whole"]:
            print(f"Not found or found in part only: {', '.join(coverage['not_whole'])}.")
        if embedding.note:
            print(f"Note: {embedding.note}.")
        if embedding.constant:
            print("Every episode gets the same numbers, which act as a bias of the policy.")
        if embedding.privileged:
            print("The numbers identify the episode's object and colour: privileged information.")
        shown = {"triples": triples, "entities": subgraph.entities, **to_dict(described)}
        numbers = {"shape": [embedding.dim], "vector": embedding.vector.tolist()}
        return {**shown, "sentences": sentences, **numbers}


@dataclass(frozen=True, kw_only=True)
class Embed(SceneOptions):
    """Embed objects and write one row of numbers per slot."""

    out: Path | None = None
    """Write the slots, (S, D) float32: .npy, or .safetensors, which names them."""

    def result(self) -> dict[str, Any]:
        """Embed, print and write."""
        check_out(self.out, "vectors", (".npy", ".safetensors"))
        embedding = scene_embedding(self.config(), self.facets(), run_seed=self.run_seed())
        rows = [
            [slot.name, " ".join(f"{x:.3f}" for x in row[:6]) + " ...", float(np.linalg.norm(row))]
            for slot, row in zip(embedding.slots, embedding.matrix, strict=True)
        ]
        slots = f"{len(rows)} slot{'s' * (len(rows) != 1)} of {embedding.slot_dim} numbers"
        title = f"{slots}, {embedding.dim} to the policy"
        print_table(title, ["slot", "numbers", "norm"], rows)
        if self.out is not None:
            with replacing(self.out, "Give another path.") as temporary:
                _write(embedding, temporary)
            print(f"Wrote {self.out}")
        return {**to_dict(embedding.describe()), "vectors": embedding.matrix.tolist()}


def _write(embedding: SceneEmbedding, path: Path) -> None:
    if path.suffix == ".npy":
        np.save(path, embedding.matrix)
        return
    names = ",".join(slot.name for slot in embedding.slots)
    save_file({"slots": np.ascontiguousarray(embedding.matrix)}, path, {"slots": names})


@dataclass(frozen=True, kw_only=True)
class ProbeCommand(SceneOptions):
    """Test whether facets can be distinguished and their facts recovered from the vectors."""

    def result(self) -> dict[str, Any]:
        """Print cosines, the accuracy of linear probes, and a warning where facets are alike."""
        config = self.config()
        separation = probe(config, self.facets(), run_seed=self.run_seed())
        title = f"Cosine of facets: {self.agent or config.source.short_name}"
        numbers = [str(i) for i in range(1, len(separation.slots) + 1)]
        rows = [
            [number, name, *(None if np.isnan(x) else float(x) for x in row)]
            for number, name, row in zip(numbers, separation.slots, separation.cosine, strict=True)
        ]
        print_table(title, ["", "facet", *numbers], rows)
        if separation.recovered:
            columns = ["target", "the task's", "all objects'", "by guessing"]
            shares = [[n, s["task"], s["all"], s["guess"]] for n, s in separation.recovered.items()]
            print_table("Share recovered by a linear probe", columns, shares)
        elif not config.source.placebo:
            print("Nothing to recover: no object, colour or value describes two facets.")
        else:
            print("Nothing to recover: these numbers do not come from the facts about the objects.")
        for first, second, cosine in separation.nearly_same:
            print(f"Warning: {first} and {second} are nearly the same (cosine {cosine:.3f}).")
        if separation.nearly_same:
            print(
                "A policy can hardly tell these apart. Slots are farther apart with "
                "--no-relation-words --pooling sif --centring --colour-share 0.6 --slot-norm 1."
            )
        elif separation.recovered:
            print(f"Every pair of facets can be distinguished: all cosines below {NEARLY_SAME}.")
        return separation.describe()
