"""A name goes in; the word vectors that come with the package come out."""

from functools import cache
from pathlib import Path

import numpy as np
from safetensors.numpy import load_file

from knowarm.knowledge.vectors.word_vectors import WordVectors

DATA = Path(__file__).parent / "data"

SHIPPED = {"wordnet-gloss-50": DATA / "wordnet-gloss-50.safetensors"}
"""Files of the shipped vectors: float16 `vectors` (n, dim), uint8 `words` (UTF-8, one a line).

`wordnet-gloss-50` is made by scripts/build_wordnet_vectors.py from WordNet's glosses.
"""


@cache
def shipped_vectors(name: str) -> WordVectors:
    """Load shipped word vectors, all words, once a process."""
    tensors = load_file(SHIPPED[name])
    words = tuple(tensors["words"].tobytes().decode().split("\n"))
    return WordVectors(
        name=name,
        words=words,
        vectors=tensors["vectors"].astype(np.float32),
        ranks=np.arange(1, len(words) + 1),
        size=len(words),
    )
