"""Word vectors go in; a source that finds every label it can, and says what it could not, out."""

import hashlib
from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.sentence import Part
from knowarm.knowledge.vectors.coverage import Coverage
from knowarm.knowledge.vectors.forms import joined_forms, word_forms
from knowarm.knowledge.vectors.source import Found
from knowarm.knowledge.vectors.word_vectors import WordVectors

OnMissing = Literal["error", "skip", "hash"]


class WordSource:
    """Finds labels among word vectors.

    A label is tried as one word, joined (`light-blue`), then word by word; a word is tried as it
    stands, as the user's alias, in another spelling, singular, and as a lemma.
    """

    def __init__(
        self,
        vectors: WordVectors,
        *,
        aliases: Mapping[str, str] | None = None,
        on_missing: OnMissing = "error",
    ) -> None:
        """Make a source.

        Args:
            vectors: where to look.
            aliases: other words for a label or word, e.g. {"irb120": "robot arm"}.
            on_missing: what to do with a label of which no word is known: raise an error, leave
                it out, or give each word a fixed random vector made of its letters.
        """
        self.words = vectors
        self.name = vectors.name
        self.dim = vectors.dim
        self.aliases = {k.lower(): v.lower() for k, v in (aliases or {}).items()}
        self.on_missing = on_missing

    def find(self, part: Part, coverage: Coverage) -> Found:
        """Return the vectors of a label's words.

        Raises:
            UserError: no word of the label is known and `on_missing` is "error".
        """
        rows, kind, missing = self._rows(part.label)
        if rows or self.on_missing != "hash":
            coverage.missing |= set(missing)
            coverage.how[part.label] = kind
        if rows:
            return Found(self.words.vectors[rows], self.words.frequencies[rows])
        if self.on_missing == "hash":
            return self._hashed(part.label, coverage)
        if self.on_missing == "error":
            raise UserError(
                f"No word of the label {part.label!r} (of {part.name!r}) is in {self.name}. "
                f"Give it another word with --aliases {part.label!r} WORD, or take "
                f"--on-missing skip or hash."
            )
        return Found(np.empty((0, self.dim), np.float32), np.empty(0))

    def _rows(self, label: str) -> tuple[list[int], str, list[str]]:
        """Return rows of the vectors, how the label was found, and words that were not."""
        index = self.words.index
        if label in index:
            return [index[label]], "word", []
        if label in self.aliases:
            rows, _, missing = self._word_by_word(self.aliases[label].split())
            return rows, "alias", missing
        for form in joined_forms(label):
            if form in index:
                return [index[form]], "joined", []
        return self._word_by_word(label.split())

    def _word_by_word(self, words: list[str]) -> tuple[list[int], str, list[str]]:
        rows, missing, kind = [], [], "words"
        for word in words:
            found = next(self._one(word), None)
            if found is None:
                missing.append(word)
            else:
                rows += found[0]
                kind = found[1] if found[1] != "words" else kind
        if missing:
            kind = "part" if rows else "missing"
        return rows, kind, missing

    def _one(self, word: str) -> Iterator[tuple[list[int], str]]:
        """Yield ways to find one word, best first."""
        index = self.words.index
        if word in index:
            yield [index[word]], "words"
        if word in self.aliases:
            known = [index[w] for w in self.aliases[word].split() if w in index]
            if known:
                yield known, "alias"
        for form in word_forms(word):
            if form in index:
                yield [index[form]], "form"

    def _hashed(self, label: str, coverage: Coverage) -> Found:
        """Return random vectors that depend on the words' letters alone, of a usual length."""
        length = float(np.median(np.linalg.norm(self.words.vectors, axis=1)))
        vectors = []
        for word in label.split():
            seed = int.from_bytes(hashlib.sha256(word.encode()).digest()[:8], "little")
            vector = np.random.default_rng(seed).standard_normal(self.dim)
            vectors.append(vector * (length / np.linalg.norm(vector)))
        coverage.how[label] = "hash"
        coverage.missing |= set(label.split())
        rarest = np.full(len(vectors), 1.0 / self.words.size)
        return Found(np.array(vectors, np.float32), rarest)
