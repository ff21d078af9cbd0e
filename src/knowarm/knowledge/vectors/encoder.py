"""Labels go in; vectors of a sentence encoder on this machine come out. An extra, not needed."""

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.sentence import Part
from knowarm.knowledge.vectors.coverage import Coverage
from knowarm.knowledge.vectors.source import Found


class EncoderSource:
    """Encodes each label with a model of the package sentence-transformers.

    Nothing is ever missing, and no word frequencies are known: SIF then weighs all alike.
    """

    def __init__(self, model: str) -> None:
        """Load a model by its path or name.

        Raises:
            UserError: the package is not installed or the model is not at hand.
        """
        try:
            from sentence_transformers import SentenceTransformer
        except ImportError as error:
            raise UserError(
                "Sentence encoders need the package sentence-transformers. Install it with "
                "`pip install sentence-transformers`, or take --source wordnet-gloss-50."
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

    def find(self, part: Part, coverage: Coverage) -> Found:
        """Return one vector for the whole label."""
        coverage.how[part.label] = "word"
        vector = self._encoder.encode([part.label], convert_to_numpy=True, show_progress_bar=False)
        return Found(np.asarray(vector, np.float32), np.zeros(1))
