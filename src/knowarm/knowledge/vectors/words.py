"""Word vectors, shipped or from a file, and the lookup of labels among them."""

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from safetensors.numpy import load_file

from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.sentence import Part
from knowarm.knowledge.vectors.source import (
    Coverage,
    Found,
    OnMissing,
    Request,
    VectorLookup,
    VectorSource,
)
from knowarm.knowledge.vectors.word_forms import all_forms, joined_forms, word_forms

DATA = Path(__file__).parent / "data"

SHIPPED = {"wordnet-gloss-50": DATA / "wordnet-gloss-50.safetensors"}
"""Files of the shipped vectors: float16 `vectors` (n, dim), uint8 `words` (UTF-8, one per line).

`wordnet-gloss-50` is made by scripts/build_wordnet_vectors.py from WordNet's glosses.
"""


@dataclass(frozen=True, kw_only=True)
class WordVectors(VectorSource):
    """One vector per word of a label."""

    kind: Literal["words"] = "words"
    """Tells this source from the others in a file."""
    name: str = "wordnet-gloss-50"
    """Key of `SHIPPED`: vectors that come with the package."""
    file: str | None = None
    """Path of a file in GloVe's format to read instead, e.g. glove.6B.50d.txt."""

    @property
    def short_name(self) -> str:
        """Name of the vectors or path of the file."""
        return self.file or self.name

    def open(self, request: Request) -> VectorLookup:
        """Load the shipped vectors, or read the words of the request from the file."""
        if self.file is not None:
            from knowarm.knowledge.vectors.glove import read_word_vectors

            parts, aliases = request.parts, request.aliases
            forms = {form for part in parts for form in all_forms(part.label, aliases)}
            table = read_word_vectors(Path(self.file), forms)
        elif self.name in SHIPPED:
            table = shipped_vectors(self.name)
        else:
            raise unknown_name("shipped word vectors", self.name, SHIPPED)
        return WordLookup(table, aliases=request.aliases, on_missing=request.on_missing)


@dataclass(frozen=True, kw_only=True)
class WordTable:
    """Words with their vectors and their frequency ranks."""

    name: str
    """Name in reports: a shipped name or a file's name."""
    words: tuple[str, ...]
    """The words held here; of a file, only those that were requested."""
    vectors: np.ndarray = field(repr=False)
    """One row per word, (n, dim) float32."""
    ranks: np.ndarray = field(repr=False)
    """Place of each word in the file, 1 = most frequent, (n,) int64."""
    size: int
    """Number of words in the whole file."""

    @property
    def dim(self) -> int:
        """Numbers per word."""
        return int(self.vectors.shape[1])

    @cached_property
    def index(self) -> dict[str, int]:
        """Row by word."""
        return {word: row for row, word in enumerate(self.words)}

    @cached_property
    def frequencies(self) -> np.ndarray:
        """Estimated share of each word in running text, (n,) float64.

        Zipf's law, p(rank) = 1 / (rank * H(size)): a vector file gives the order of words only.
        """
        harmonic = np.log(self.size) + 0.5772156649
        return 1.0 / (self.ranks * harmonic)


@cache
def shipped_vectors(name: str) -> WordTable:
    """Load shipped word vectors, all words, once per process."""
    tensors = load_file(SHIPPED[name])
    words = tuple(tensors["words"].tobytes().decode().split("\n"))
    return WordTable(
        name=name,
        words=words,
        vectors=tensors["vectors"].astype(np.float32),
        ranks=np.arange(1, len(words) + 1),
        size=len(words),
    )


class WordLookup:
    """Finds labels among word vectors.

    A label is tried as one word, as an alias, joined (`light-blue`), then word by word. A word is
    tried unchanged, as an alias, in another spelling, in the singular, and as a lemma.
    """

    def __init__(
        self,
        vectors: WordTable,
        *,
        aliases: Mapping[str, str] | None = None,
        on_missing: OnMissing = "error",
    ) -> None:
        """Make a lookup.

        Args:
            vectors: the words.
            aliases: other words for a label or word, e.g. {"cobot": "robot arm"}.
            on_missing: what to do with a label of which no word is known.
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
                f"Give it another word in `aliases`, e.g. {{{part.label!r}: 'word'}}, or set "
                f"on_missing to 'skip' or 'hash'."
            )
        return Found(np.empty((0, self.dim), np.float32), np.empty(0))

    def _rows(self, label: str) -> tuple[list[int], str, list[str]]:
        """Return rows of the vectors, how the label was found, and the words that were not."""
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
        """Return random vectors of the median length that depend on the words' letters only."""
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
