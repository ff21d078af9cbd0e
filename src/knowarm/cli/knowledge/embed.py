"""`knowarm knowledge embed`: write the slots of a scene embedding to a file."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from safetensors.numpy import save_file

from knowarm.cli.knowledge.options import SceneOptions
from knowarm.cli.tables import check_json_path, print_table, write_json_table
from knowarm.errors import UserError
from knowarm.knowledge import SceneEmbedding, scene_embedding

SUFFIXES = (".npy", ".csv", ".safetensors")


@dataclass(frozen=True, kw_only=True)
class Embed(SceneOptions):
    """Embed objects and write one row of numbers per slot."""

    out: Path | None = None
    """Write the slots: .npy and .safetensors hold (S, D) float32, .csv one named row per slot."""
    json: Path | None = None
    """Write the vectors and their description as JSON to this file."""

    def run(self) -> None:
        """Embed, print and write."""
        check_json_path(self.json)
        if self.out is not None and self.out.suffix not in SUFFIXES:
            raise UserError(f"--out {self.out}: vectors are written as {', '.join(SUFFIXES)}.")
        embedding = scene_embedding(self.config(), self.facets())
        rows = [
            [slot.name, " ".join(f"{x:.3f}" for x in row[:6]) + " ...", float(np.linalg.norm(row))]
            for slot, row in zip(embedding.slots, embedding.matrix, strict=True)
        ]
        slots = f"{len(rows)} slot{'s' * (len(rows) != 1)} of {embedding.slot_dim} numbers"
        title = f"{slots}, {embedding.dim} to the policy"
        print_table(title, ["slot", "numbers", "norm"], rows)
        if self.out is not None:
            _write(embedding, self.out)
            print(f"Wrote {self.out}")
        write_json_table(self.json, {**embedding.describe(), "vectors": embedding.matrix.tolist()})


def _write(embedding: SceneEmbedding, path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".npy":
            np.save(path, embedding.matrix)
        elif path.suffix == ".safetensors":
            names = ",".join(slot.name for slot in embedding.slots)
            save_file({"slots": np.ascontiguousarray(embedding.matrix)}, path, {"slots": names})
        else:
            lines = [
                ",".join([slot.name, *map(repr, map(float, row))])
                for slot, row in zip(embedding.slots, embedding.matrix, strict=True)
            ]
            header = ",".join(["slot", *(f"v{i}" for i in range(embedding.slot_dim))])
            path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
    except OSError as error:
        raise UserError(f"Cannot write {path}: {error.strerror}. Give another path.") from error
