"""Sentence encoders of the optional package sentence-transformers, run on this machine."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.vectors.source import Coverage, Found, Request, SentencePart, VectorSource


@dataclass(frozen=True, kw_only=True)
class SentenceEncoder(VectorSource):
    """One vector per label, from a sentence encoder."""

    kind: Literal["sentence-transformers"] = "sentence-transformers"
    """Tells this source from the others in a file."""
    model: str
    """Path of a model folder, or the name of a model in the local cache."""

    def open(self, request: Request) -> "EncoderLookup":
        """Load the model."""
        return EncoderLookup(self.model)


class EncoderLookup:
    """Encodes labels; none is ever missing, and all have the same SIF weight."""

    def __init__(self, model: str) -> None:
        """Load a model by its path or name."""
        try:
            from sentence_transformers import SentenceTransformer
        except ImportError as error:
            raise UserError(
                "Sentence encoders need the package sentence-transformers. Install it with "
                "`pip install sentence-transformers`, or take the word vectors wordnet-gloss-50."
            ) from error
        try:
            self._encoder = SentenceTransformer(model, device="cpu")
        except (OSError, ValueError) as error:
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            raise UserError(
                f"The sentence encoder {model!r} cannot be loaded: {reason}. Give the path of a "
                f"model folder on this machine."
            ) from error
        self.name = model
        self.dim = int(self._encoder.get_sentence_embedding_dimension())

    def find(self, part: SentencePart, coverage: Coverage) -> Found:
        """Return one vector for the whole label."""
        coverage.how[part.label] = "word"
        vector = self._encoder.encode([part.label], convert_to_numpy=True, show_progress_bar=False)
        return Found(np.asarray(vector, np.float32), np.zeros(1))
