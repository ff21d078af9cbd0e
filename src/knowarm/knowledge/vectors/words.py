"""Word vectors, shipped or from a file in the formats of GloVe and word2vec, and their lookup."""

import hashlib
import math
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import chain, islice
from pathlib import Path
from typing import Literal

import numpy as np
from safetensors.numpy import load_file

from knowarm.errors import Argument, UserError, unknown_name
from knowarm.knowledge.formats.files import byte_lines, decode, open_bytes
from knowarm.knowledge.vectors.source import (
    Coverage,
    Found,
    OnMissing,
    Request,
    SentencePart,
    VectorLookup,
    VectorSource,
)
from knowarm.reading import reading

DATA = Path(__file__).parent / "data"
SHIPPED = {"wordnet-gloss-50": DATA / "wordnet-gloss-50.safetensors"}
"""Files of the shipped vectors: float16 `vectors` (n, dim), uint8 `words` (UTF-8, one per line).

`wordnet-gloss-50` is made by scripts/build_wordnet_vectors.py from WordNet's glosses.
"""
_HEADER = re.compile(rb"\d+ \d+ *")
_NUMBER = re.compile(r"[-+]?\d+\.\d+(?:[eE][-+]?\d+)?")
_FIRST_LINES = 100
_BEGINNING = 4096  # bytes by which binary vectors are recognized
_BRITISH = ["colour", "grey", "aluminium", "centre", "fibre", "jewellery", "mould", "tyre"]
_AMERICAN = ["color", "gray", "aluminum", "center", "fiber", "jewelry", "mold", "tire"]
_SPELLINGS = dict(zip(_BRITISH + _AMERICAN, _AMERICAN + _BRITISH, strict=True))
"""Other spelling of a word."""


@dataclass(frozen=True)
class WordTable:
    """Words with their vectors and their frequency ranks."""

    name: str  # Name in reports: a shipped name or a file's name
    words: tuple[str, ...]  # The words held here; of a file, only those that were requested
    vectors: np.ndarray = field(repr=False)  # One row per word, (n, dim) float32
    # Place of each word in the file, 1 = most frequent, (n,) int64
    ranks: np.ndarray = field(repr=False)
    size: int  # Number of words in the whole file
    length: float  # Median length of its vectors, of a file of its first hundred

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
        return 1.0 / (self.ranks * (np.log(self.size) + 0.5772156649))


def read_word_vectors(path: Path, wanted: Collection[str] | None = None) -> WordTable:
    """Read word vectors: lines of `word number number ...`, most frequent word first.

    The file is plain text, .gz, .bz2, .xz or .zip (with one member) and may have a
    word2vec header and words that contain spaces. Numbers are parsed for wanted words only: a file
    of 400,000 words x 50 takes about a second.
    """
    if not path.is_file():
        raise UserError(
            f"There is no word-vector file {path}. Give the path of a file in GloVe's format "
            f"(glove.6B.50d.txt), or take the shipped vectors wordnet-gloss-50."
        )
    if _is_binary(path):
        raise UserError(
            f"{path}: binary vectors are not read. Save them as text: in gensim "
            f"`KeyedVectors.load_word2vec_format(..., binary=True).save_word2vec_format('v.txt')`."
        )
    keep = None if wanted is None else {word.encode() for word in wanted}
    first_words = None if keep is None else {word.split(b" ", 1)[0] for word in keep}
    words: list[str] = []
    rows: list[np.ndarray] = []
    ranks: list[int] = []
    seen: set[bytes] = set()
    count = 0
    lines = byte_lines(path)
    beginning = list(islice(lines, _FIRST_LINES))
    header = int(bool(beginning) and _HEADER.fullmatch(beginning[0][1]) is not None)
    dim = _dimension([line for _, line in beginning[header:]], path, header)
    lengths = [_length(line, dim) for _, line in beginning[header:]]
    length = float(np.median([value for value in lengths if np.isfinite(value)] or [1.0]))
    for number, line in chain(beginning, lines):
        if line.count(b" ") != dim:
            if number <= header or not line.strip():
                continue
            line = line.rstrip(b" ")
            if line.count(b" ") != dim:
                _check_wide(line, dim, path, number)
        count += 1
        if first_words is not None and line[: line.find(b" ")] not in first_words:
            continue
        word, *numbers = line.rsplit(b" ", dim)
        if word in seen or (keep is not None and word not in keep):
            continue
        seen.add(word)
        words.append(decode(word, path, number))
        ranks.append(count)
        try:
            rows.append(np.array(numbers, dtype=np.float32))
        except ValueError:
            rows.append(np.full(dim, np.nan, np.float32))
        if not np.isfinite(rows[-1]).all():
            raise UserError(
                f"{path}, line {number}: the vector of {words[-1]!r} contains a non-finite value "
                "or text. Correct or delete the line."
            )
    vectors = np.array(rows, np.float32).reshape(len(rows), dim)
    return WordTable(path.name, tuple(words), vectors, np.array(ranks), count, length)


def _is_binary(path: Path) -> bool:
    """Return whether a file does not begin as text."""
    with reading(path, "Copy or compress it again."), open_bytes(path) as file:
        start = file.read(_BEGINNING)
    no_text = len(start) - len(start.decode(errors="ignore").encode())
    return b"\0" in start or 10 * no_text > len(start)


def _dimension(lines: list[bytes], path: Path, header: int) -> int:
    """Return the dimension of most of the first lines."""
    fields = Counter(len(line.split()) - 1 for line in lines if line.strip())
    dim = max(fields, key=lambda n: fields[n], default=0)
    if dim < 2:
        raise UserError(
            f"{path}, line {1 + header}: expected a word and its numbers, separated by spaces. "
            f"Give a file in GloVe's format, e.g. glove.6B.50d.txt."
        )
    return dim


def _length(line: bytes, dim: int) -> float:
    """Return the length of the vector of a line, NaN if it holds none."""
    with suppress(ValueError):
        return float(np.linalg.norm(np.array(line.rstrip(b" ").rsplit(b" ", dim)[1:], np.float32)))
    return math.nan


def _check_wide(line: bytes, dim: int, path: Path, number: int) -> None:
    """Accept a line whose word contains spaces; refuse one of another dimension."""
    fields = line.split(b" ")
    extra = [field.decode(errors="replace") for field in fields[1:-dim]]
    if len(fields) - 1 < dim or (extra and all(_NUMBER.fullmatch(field) for field in extra)):
        raise UserError(
            f"{path}, line {number}: has {len(fields) - 1} numbers, the lines before {dim}. "
            f"All words of a file must have the same dimension; download the file again."
        )


@dataclass(frozen=True, kw_only=True)
class WordVectors(VectorSource):
    """One vector per word of a label."""

    kind: Literal["words"] = "words"
    """Tells this source from the others in a file."""
    name: str = "wordnet-gloss-50"
    """Name of vectors that come with the package."""
    file: str | None = None
    """Path of a file in GloVe's format to read instead, e.g. glove.6B.50d.txt."""

    @property
    def short_name(self) -> str:
        """Name of the vectors or path of the file."""
        return self.file or self.name

    def open(self, request: Request) -> VectorLookup:
        """Load the shipped vectors, or read the words of the request from the file."""
        if self.file is not None:
            parts, aliases = request.parts, request.aliases
            forms = {form for part in parts for form in all_forms(part.label, aliases)}
            table = read_word_vectors(Path(self.file), forms)
        elif self.name in SHIPPED:
            table = shipped_vectors(self.name)
        else:
            raise unknown_name("shipped word vectors", self.name, SHIPPED)
        return WordLookup(table, aliases=request.aliases, on_missing=request.on_missing)


@cache
def shipped_vectors(name: str) -> WordTable:
    """Load shipped word vectors, all words, once per process."""
    tensors = load_file(SHIPPED[name])
    words = tuple(tensors["words"].tobytes().decode().split("\n"))
    vectors, ranks = tensors["vectors"].astype(np.float32), np.arange(1, len(words) + 1)
    length = float(np.median(np.linalg.norm(vectors, axis=1)))
    return WordTable(name, words, vectors, ranks, len(words), length)


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
        self.words = vectors
        self.name = vectors.name
        self.dim = vectors.dim
        self.aliases = {k.lower(): v.lower() for k, v in (aliases or {}).items()}
        self.on_missing = on_missing

    def find(self, part: SentencePart, coverage: Coverage) -> Found:
        """Return the vectors of a label's words."""
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
                "Give it another word, ",
                Argument("knows.aliases", {part.label: "word"}),
                ", or use ",
                Argument("knows.on_missing", "skip"),
                " or ",
                Argument("knows.on_missing", "hash"),
                ".",
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
        rows, missing, kind = list[int](), list[str](), "words"
        for word in words:
            word_rows, how = self._one(word)
            rows += word_rows
            missing += [] if word_rows else [word]
            kind = how or kind
        return rows, ("part" if rows else "missing") if missing else kind, missing

    def _one(self, word: str) -> tuple[list[int], str]:
        """Return the rows of one word, and how it was found if that was not unchanged."""
        index = self.words.index
        if word in index:
            return [index[word]], ""
        if rows := [index[w] for w in self.aliases.get(word, "").split() if w in index]:
            return rows, "alias"
        rows = [index[form] for form in word_forms(word) if form in index][:1]
        return rows, "form" if rows else ""

    def _hashed(self, label: str, coverage: Coverage) -> Found:
        """Return random vectors of the median length that depend on the words' letters only."""
        vectors = []
        for word in label.split():
            seed = int.from_bytes(hashlib.sha256(word.encode()).digest()[:8], "little")
            vector = np.random.default_rng(seed).standard_normal(self.dim)
            vectors.append(vector * (self.words.length / np.linalg.norm(vector)))
        coverage.how[label] = "hash"
        coverage.missing |= set(label.split())
        rarest = np.full(len(vectors), 1.0 / self.words.size)
        return Found(np.array(vectors, np.float32).reshape(-1, self.dim), rarest)


def joined_forms(label: str) -> list[str]:
    """Return the spellings of a label of several words as one word."""
    words = label.split()
    return [glue.join(words) for glue in ("-", "_", "", " ")] if len(words) > 1 else []


def word_forms(word: str) -> list[str]:
    """Return other forms of a word, nearest first: spelling, singular, lemma."""
    forms = [_SPELLINGS[word]] if word in _SPELLINGS else []
    forms += _stems(word)
    return list(dict.fromkeys(form for form in forms if len(form) > 1 and form != word))


def all_forms(label: str, aliases: Mapping[str, str]) -> set[str]:
    """Return every spelling that the lookup of a label may try."""
    aliased = {key.lower(): alias.lower().split() for key, alias in aliases.items()}
    words = [*label.split(), *aliased.get(label, ())]
    words += [other for word in words for other in aliased.get(word, ())]
    forms = (form for word in words for form in (word, *word_forms(word)))
    return {label, *joined_forms(label), *forms}


def _stems(word: str) -> Iterator[str]:
    """Yield the singular of a word, then its lemmas."""
    if word.endswith("'s"):
        yield word[:-2]
    if word.endswith("ies"):
        yield word[:-3] + "y"
    if word.endswith(("ses", "xes", "zes", "ches", "shes", "oes")):
        yield word[:-2]
    if word.endswith("ves"):
        yield word[:-3] + "f"
        yield word[:-3] + "fe"
    if word.endswith("s") and not word.endswith("ss"):
        yield word[:-1]
    for ending in ("ing", "ed", "er", "est", "ly"):
        stem = word.removesuffix(ending)
        if stem == word or len(stem) < 3:
            continue
        yield stem
        yield stem + "e"
        if stem[-1] == stem[-2] and stem[-1] not in "aeiou":
            yield stem[:-1]
        if stem.endswith("i"):
            yield stem[:-1] + "y"
