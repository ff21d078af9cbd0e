"""`knowarm knowledge show`, `embed` and `probe`: sentences and vectors of a scene's objects."""

from dataclasses import dataclass
from itertools import repeat
from pathlib import Path

import numpy as np
from safetensors.numpy import save_file

from knowarm.cli.knowledge.options import SceneOptions, short_names
from knowarm.cli.tables import Values, check_out, counted, print_table
from knowarm.config import to_dict
from knowarm.knowledge import (
    SceneEmbedding,
    scene_embedding,
    scene_sentences,
    scene_subgraph,
)
from knowarm.knowledge.probe import NEARLY_SAME, probe
from knowarm.reading import replacing


@dataclass(frozen=True, kw_only=True)
class KnowledgeShow(SceneOptions):
    """Show the facts of the graph about objects, as triples, sentences and a vector."""

    def result(self) -> Values:
        """Print the subgraph, the sentence of each slot, and the embedding's shape and norm."""
        config, facets, seed = self.scene()
        embedding = scene_embedding(config, facets, run_seed=seed)
        subgraph = scene_subgraph(config, facets, run_seed=seed)
        triples = list(subgraph)
        title = f"Subgraph: {len(triples)} triples, {len(subgraph.nodes)} entities"
        print_table(title, ["head", "relation", "tail"], short_names(triples))
        sentences = scene_sentences(config, facets, run_seed=seed)
        print_table("Sentences", ["slot", "sentence"], sentences.items())
        described = embedding.describe()
        dim = embedding.slot_dim
        print_table(
            f"Embedding: shape ({embedding.dim},), norm {embedding.norm:.3f}, "
            f"source {config.source.short_name}, scope {config.scope}",
            ["slot", "numbers", "norm"],
            zip(described.slots, repeat(dim), described.slot_norms, strict=False),
        )
        coverage = described.coverage
        if coverage["labels"]:
            print(
                f"Labels found: {100 * coverage['share']:.0f} % of {coverage['labels']}."
            )
        if coverage["not_whole"]:
            print(
                f"Not found or found in part only: {', '.join(coverage['not_whole'])}."
            )
        if embedding.note:
            print(f"Note: {embedding.note}.")
        if embedding.constant:
            print(
                "Every episode gets the same numbers, which act as a bias of the policy."
            )
        if embedding.privileged:
            print(
                "The numbers identify the episode's object and colour: privileged information."
            )
        return {
            "triples": triples,
            "entities": subgraph.entities,
            **to_dict(described),
            "sentences": sentences,
            "shape": [embedding.dim],
            "vector": embedding.vector.tolist(),
        }


@dataclass(frozen=True, kw_only=True)
class Embed(SceneOptions):
    """Embed objects and write one row of numbers per slot."""

    out: Path | None = None
    """Write the slots, (S, D) float32: .npy, or .safetensors, which names them."""

    def result(self) -> Values:
        """Embed, print and write."""
        check_out(self.out, "vectors", (".npy", ".safetensors"))
        config, facets, seed = self.scene()
        embedding = scene_embedding(config, facets, run_seed=seed)
        rows = []
        for slot, vector in zip(embedding.slots, embedding.matrix, strict=True):
            numbers = " ".join(f"{x:.3f}" for x in vector[:6])
            rows.append([slot.name, f"{numbers} ...", float(np.linalg.norm(vector))])
        slots = counted(len(rows), "slot")
        title = (
            f"{slots} of {embedding.slot_dim} numbers, {embedding.dim} to the policy"
        )
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

    def result(self) -> Values:
        """Print cosines, the accuracy of linear probes, and a warning where facets are alike."""
        config, facets, seed = self.scene()
        separation = probe(config, facets, run_seed=seed)
        columns = ["", "facet"]
        rows = []
        cells = separation.cosine.astype(object)
        cells[np.isnan(separation.cosine)] = None
        for number, name in enumerate(separation.slots, start=1):
            columns.append(str(number))
            rows.append([str(number), name, *cells[number - 1]])
        title = f"Cosine of facets: {self.agent or config.source.short_name}"
        print_table(title, columns, rows)
        if separation.recovered:
            columns = ["target", "the task's", "all objects'", "by guessing"]
            recovered = separation.recovered.items()
            shares = [[name, *share.values()] for name, share in recovered]
            print_table("Share recovered by a linear probe", columns, shares)
        elif not config.source.placebo:
            print(
                "Nothing to recover: no object, colour or value describes two facets."
            )
        else:
            print(
                "Nothing to recover: these numbers do not come from the facts about the objects."
            )
        for first, second, cosine in separation.nearly_same:
            print(
                f"Warning: {first} and {second} are nearly the same (cosine {cosine:.3f})."
            )
        if separation.nearly_same:
            print(
                "A policy can hardly tell these apart. Slots are farther apart with "
                "--no-relation-words --pooling sif --centring --colour-share 0.6 --slot-norm 1."
            )
        elif separation.recovered:
            print(
                f"Every pair of facets can be distinguished: all cosines below {NEARLY_SAME}."
            )
        return separation.describe()
