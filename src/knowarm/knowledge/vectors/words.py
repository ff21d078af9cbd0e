"""Word vectors, shipped or from a file in the formats of GloVe and word2vec, and their lookup."""

import hashlib
import math
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import chain, islice
from pathlib import Path
from typing import Literal

import numpy as np
from safetensors.numpy import load_file

from knowarm.arrays import Floats, Integers
from knowarm.errors import Argument, UserError, unknown_name
from knowarm.knowledge.formats.files import byte_lines, decode, open_bytes
from knowarm.knowledge.vectors.source import (
    Coverage,
    Found,
    OnMissing,
    Request,
    SentencePart,
    VectorLookup,
    Vectors,
    VectorSource,
)
from knowarm.reading import reading

DATA = Path(__file__).parent / "data"
SHIPPED = {
    "wordnet-gloss-50": DATA / "wordnet-gloss-50.safetensors",
    "glove-6b-50": DATA / "glove-6b-50.safetensors",
}
"""Files of the shipped vectors: `vectors` (n, dim), uint8 `words` (UTF-8, one per line), and of a
part of a larger table the `ranks` of its words there (n,), and the `size` of that table (1,).

`wordnet-gloss-50` is made by scripts/build_wordnet_vectors.py from WordNet's glosses. `glove-6b-50`
are the words of the shipped graphs from GloVe (the paper's vectors), by
scripts/build_glove_vectors.py.
"""
_HEADER = re.compile(rb"\d+ \d+ *")
_NUMBER = re.compile(r"[-+]?\d+\.\d+(?:[eE][-+]?\d+)?")
_FIRST_LINES = 100
_BEGINNING = 4096  # bytes by which binary vectors are recognized
_AMERICAN = {
    "colour": "color",
    "grey": "gray",
    "aluminium": "aluminum",
    "centre": "center",
    "fibre": "fiber",
    "jewellery": "jewelry",
    "mould": "mold",
    "tyre": "tire",
}
_SINGULARS = (
    (r"'s\Z", ""),
    (r"ies\Z", "y"),
    (r"([sxzo]|ch|sh)es\Z", r"\1"),
    (r"ves\Z", "f"),
    (r"ves\Z", "fe"),
    (r"(?<!s)s\Z", ""),
)
"""Patterns of plurals, and what stands in place of them in the singular."""
_SPELLINGS = _AMERICAN | {american: british for british, american in _AMERICAN.items()}
"""Other spelling of a word."""


@dataclass(frozen=True)
class WordTable:
    """Words with their vectors and their frequency ranks."""

    name: str  # Name in reports: a shipped name or a file's name
    # The words held here; of a file, only those that were requested
    words: tuple[str, ...]
    vectors: Vectors = field(repr=False)  # One row per word, (n, dim) float32
    # Place of each word in the file, 1 = most frequent, (n,) int64
    ranks: Integers = field(repr=False)
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
    def frequencies(self) -> Floats:
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
    kept = None
    first_words = None
    if wanted is not None:
        kept = set(map(str.encode, wanted))
        first_words = {word.split(b" ", 1)[0] for word in kept}
    lines = byte_lines(path)
    beginning = list(islice(lines, _FIRST_LINES))
    header = int(bool(beginning) and _HEADER.fullmatch(beginning[0][1]) is not None)
    sample = [line for _, line in beginning[header:]]
    dim = _dimension(sample, path, header)
    vectors: dict[str, Vectors] = {}
    ranks = []
    count = 0
    for number, line in chain(beginning, lines):
        if line.count(b" ") != dim:
            if number <= header or not line.strip():
                continue
            line = line.rstrip(b" ")
            if line.count(b" ") != dim:
                _check_wide(line, dim, path, number)
        count += 1
        # The first word is compared before the line is split, which takes most of the time.
        if first_words is not None and line[: line.find(b" ")] not in first_words:
            continue
        word, *numbers = line.rsplit(b" ", dim)
        if kept is not None and word not in kept:
            continue
        text = decode(word, path, number)
        if text in vectors:
            continue
        vector = _parse(numbers)
        if not np.isfinite(vector).all():
            raise UserError(
                f"{path}, line {number}: the vector of {text!r} contains a non-finite value "
                "or text. Correct or delete the line."
            )
        vectors[text] = vector
        ranks.append(count)
    return WordTable(
        name=path.name,
        words=tuple(vectors),
        vectors=np.array(list(vectors.values()), np.float32).reshape(-1, dim),
        ranks=np.array(ranks),
        size=count,
        length=_median_length(sample, dim),
    )


def _is_binary(path: Path) -> bool:
    """Return whether a file does not begin as text."""
    with reading(path, "Copy or compress it again."), open_bytes(path) as file:
        start = file.read(_BEGINNING)
    no_text = len(start) - len(start.decode(errors="ignore").encode())
    return b"\0" in start or 10 * no_text > len(start)


def _dimension(lines: list[bytes], path: Path, header: int) -> int:
    """Return the dimension of most of the first lines."""
    dims = Counter(len(line.split()) - 1 for line in lines if line.strip())
    dim = max(dims, key=dims.__getitem__, default=0)
    if dim < 2:
        raise UserError(
            f"{path}, line {1 + header}: expected a word and its numbers, separated by spaces. "
            f"Give a file in GloVe's format, e.g. glove.6B.50d.txt."
        )
    return dim


def _parse(numbers: list[bytes]) -> Vectors:
    """Return numbers as float32, or one NaN if there is text among them."""
    try:
        return np.array(numbers, np.float32)
    except ValueError:
        return np.full(1, np.nan, np.float32)


def _median_length(lines: list[bytes], dim: int) -> float:
    """Return the median length of the vectors of some lines; 1 if none of them holds one."""
    lengths = []
    for line in lines:
        numbers = line.rstrip(b" ").rsplit(b" ", dim)[1:]
        length = float(np.linalg.norm(_parse(numbers)))
        if math.isfinite(length):
            lengths.append(length)
    return float(np.median(lengths or [1.0]))


def _check_wide(line: bytes, dim: int, path: Path, number: int) -> None:
    """Accept a line whose word contains spaces; refuse one of another dimension."""
    fields = line.split(b" ")
    extra = [field.decode(errors="replace") for field in fields[1:-dim]]
    if len(fields) - 1 < dim or (extra and all(map(_NUMBER.fullmatch, extra))):
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
            forms = set[str]()
            for part in request.parts:
                forms |= all_forms(part.label, request.aliases)
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
    vectors = tensors["vectors"].astype(np.float32)
    ranks = tensors.get("ranks", np.arange(1, len(words) + 1))
    return WordTable(
        name=name,
        words=words,
        vectors=vectors,
        ranks=ranks,
        size=int(tensors.get("size", ranks).max()),
        length=float(np.median(np.linalg.norm(vectors, axis=1))),
    )


_Rows = tuple[list[int], str, list[str]]
"""Rows of word vectors, how they were found, and the words that were not."""


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
        self.aliases = _word_aliases(aliases or {})
        self.on_missing = on_missing

    def find(self, part: SentencePart, coverage: Coverage) -> Found:
        """Return the vectors of a label's words."""
        rows, kind, missing = self._rows(part.label)
        if not rows and self.on_missing == "hash":
            return self._hashed(part.label, coverage)
        coverage.missing.update(missing)
        coverage.how[part.label] = kind
        is_blank = part.name.startswith("_:")  # a node without a name has no words
        if not rows and self.on_missing == "error" and not is_blank:
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
        return Found(self.words.vectors[rows], self.words.frequencies[rows])

    def _rows(self, label: str) -> _Rows:
        """Return rows of the vectors, how the label was found, and the words that were not."""
        if label in self.words.index:
            return self._known([label]), "word", []
        if label in self.aliases:
            rows, _, missing = self._word_by_word(self.aliases[label])
            return rows, "alias", missing
        joined = self._known(joined_forms(label))
        if joined:
            return joined[:1], "joined", []
        return self._word_by_word(label.split())

    def _word_by_word(self, words: list[str]) -> _Rows:
        rows = list[int]()
        missing = []
        kind = "words"
        for word in words:
            itself = self._known([word])
            aliases = self._known(self.aliases.get(word, ()))
            forms = self._known(word_forms(word))
            rows += itself or aliases or forms[:1]
            if not itself:
                kind = "alias" if aliases else "form"
            if not (itself or aliases or forms):
                missing.append(word)
        if missing:
            kind = "part" if rows else "missing"
        return rows, kind, missing

    def _known(self, words: Iterable[str]) -> list[int]:
        """Return the rows of those words that are held."""
        index = self.words.index
        return [index[word] for word in words if word in index]

    def _hashed(self, label: str, coverage: Coverage) -> Found:
        """Return random vectors of the median length that depend on the words' letters only."""
        words = label.split()
        vectors = np.empty((len(words), self.dim), np.float32)
        for row, word in enumerate(words):
            seed = int.from_bytes(hashlib.sha256(word.encode()).digest()[:8], "little")
            vector = np.random.default_rng(seed).standard_normal(self.dim)
            vectors[row] = vector * (self.words.length / np.linalg.norm(vector))
        coverage.how[label] = "hash"
        coverage.missing.update(words)
        return Found(vectors, np.full(len(words), 1.0 / self.words.size))


def joined_forms(label: str) -> list[str]:
    """Return the spellings of a label of several words as one word."""
    words = label.split()
    if len(words) < 2:
        return []
    return [glue.join(words) for glue in ("-", "_", "", " ")]


def word_forms(word: str) -> list[str]:
    """Return other forms of a word, nearest first: spelling, singular, lemma."""
    forms = dict.fromkeys([_SPELLINGS.get(word, word), *_stems(word)])
    return [form for form in forms if len(form) > 1 and form != word]


def all_forms(label: str, aliases: Mapping[str, str]) -> set[str]:
    """Return every spelling that the lookup of a label may try."""
    other_words = _word_aliases(aliases)
    words = [*label.split(), *other_words.get(label, ())]
    for word in tuple(words):
        words += other_words.get(word, ())
    return {label, *joined_forms(label), *words, *chain(*map(word_forms, words))}


def _word_aliases(aliases: Mapping[str, str]) -> dict[str, list[str]]:
    """Return the words that labels stand for, in lower case."""
    return {label.lower(): alias.lower().split() for label, alias in aliases.items()}


def _stems(word: str) -> Iterator[str]:
    """Yield the singular of a word, then its lemmas."""
    for plural, singular in _SINGULARS:
        stem, replacements = re.subn(plural, singular, word)
        if replacements:
            yield stem
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
