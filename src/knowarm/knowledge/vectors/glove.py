"""Reader of text files of word vectors in the formats of GloVe and word2vec."""

import re
from collections import Counter
from collections.abc import Collection
from itertools import chain, islice
from pathlib import Path

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.formats.lines import byte_lines, decode
from knowarm.knowledge.vectors.words import WordTable

_HEADER = re.compile(rb"\d+ \d+ *")
_NUMBER = re.compile(r"[-+]?\d+\.\d+(?:[eE][-+]?\d+)?")
_FLOAT = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf)", re.I)
_FIRST_LINES = 100


def read_word_vectors(path: Path, wanted: Collection[str] | None = None) -> WordTable:
    """Read word vectors: lines of `word number number ...`, most frequent word first.

    The file is plain text, .gz, .bz2, .xz or .zip (with one member) and may have a
    word2vec header and words that contain spaces. Numbers are parsed for wanted words only: a file
    of 400,000 words x 50 takes about a second.

    Args:
        path: the file, e.g. glove.6B.50d.txt.
        wanted: words to keep; None keeps all words.

    Raises:
        UserError: there is no such file, a line has another dimension, or the vector of a wanted
            word contains a non-finite value; the line is named.
    """
    if not path.is_file():
        raise UserError(
            f"There is no word-vector file {path}. Give the path of a file in GloVe's format "
            f"(glove.6B.50d.txt), or take the shipped vectors wordnet-gloss-50."
        )
    if path.suffix.lower() in (".bin", ".model", ".npy"):
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
        rows.append(_vector(numbers, words[-1], path, number))
        ranks.append(count)
    vectors = np.array(rows, np.float32).reshape(len(rows), dim)
    return WordTable(
        name=path.name, words=tuple(words), vectors=vectors, ranks=np.array(ranks), size=count
    )


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


def _check_wide(line: bytes, dim: int, path: Path, number: int) -> None:
    """Accept a line whose word contains spaces; refuse one of another dimension."""
    fields = line.split(b" ")
    extra = [field.decode(errors="replace") for field in fields[1:-dim]]
    if len(fields) - 1 < dim or (extra and all(_NUMBER.fullmatch(field) for field in extra)):
        raise UserError(
            f"{path}, line {number}: has {len(fields) - 1} numbers, the lines before {dim}. "
            f"All words of a file must have the same dimension; download the file again."
        )


def _vector(numbers: list[bytes], word: str, path: Path, number: int) -> np.ndarray:
    try:
        vector = np.array(numbers, dtype=np.float32)
    except ValueError:
        bad = next((f for f in numbers if not _FLOAT.fullmatch(f)), b" ".join(numbers[:3]))
        raise UserError(
            f"{path}, line {number}: {bad.decode(errors='replace')!r} in the vector of {word!r} "
            f"is no number. Correct or delete the line."
        ) from None
    if not np.isfinite(vector).all():
        raise UserError(
            f"{path}, line {number}: the vector of {word!r} contains a non-finite value. "
            f"Correct or delete the line."
        )
    return vector
