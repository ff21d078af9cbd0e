"""Build the shipped word vectors `wordnet-gloss-50` from WordNet's glosses.

PPMI-SVD: every synset of Debian's `wordnet-base` gives one document, its words followed by its
gloss and examples. Words that stand at most ten words apart are counted, and the counts become
positive pointwise mutual information with a smoothed context distribution

    PPMI(w, c) = max(0, log p(w, c) / (p(w) p_a(c))),   p_a(c) ~ count(c)^a,  a = 0.75

(Levy, Goldberg and Dagan 2015), and a truncated SVD, U S^p, leaves 50 numbers a word, p = 0.
These vectors are read like a GloVe file but are not GloVe.

    python scripts/build_wordnet_vectors.py        # needs: apt install wordnet-base
"""

import argparse
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from safetensors.numpy import save_file
from scipy import sparse
from scipy.sparse.linalg import svds

OUTPUT = (
    Path(__file__).parent.parent
    / "src/knowarm/knowledge/vectors/data/wordnet-gloss-50.safetensors"
)
TOKEN = re.compile(r"[a-z]+(?:[-'][a-z]+)*")


def documents(wordnet: Path) -> Iterator[list[str]]:
    """Yield one token list a synset: its words, then its gloss and examples.

    A multi-word term (`cereal_box`) counts as its joined form (`cereal-box`) and as its words.
    """
    for part in ("noun", "verb", "adj", "adv"):
        with (wordnet / f"data.{part}").open(encoding="utf-8") as lines:
            for line in lines:
                if line.startswith("  "):  # the licence at the top of the file
                    continue
                fields, gloss = line.rstrip().split(" | ", 1)
                columns = fields.split(" ")
                terms = [columns[4 + 2 * i] for i in range(int(columns[3], 16))]
                tokens: list[str] = []
                for term in terms:
                    term = re.sub(r"\(.*\)$", "", term).lower().replace("_", "-")
                    if "-" in term:
                        tokens.append(term)
                    tokens += [
                        word for word in re.split(r"[-']", term) if word.isalpha()
                    ]
                yield tokens + TOKEN.findall(gloss.lower())


def cooccurrence(
    corpus: list[np.ndarray], words: int, window: int, harmonic: bool
) -> sparse.csr_matrix:
    """Count words at a distance of at most `window`. Shape (V, V)."""
    flat = np.concatenate(corpus)
    document = np.repeat(np.arange(len(corpus)), [len(tokens) for tokens in corpus])
    counts = sparse.csr_matrix((words, words), dtype=np.float32)
    for distance in range(1, window + 1):
        same = document[distance:] == document[:-distance]
        left, right = flat[:-distance][same], flat[distance:][same]
        known = (left >= 0) & (right >= 0)
        weight = np.full(known.sum(), 1 / distance if harmonic else 1.0, np.float32)
        pairs = (left[known], right[known])
        counts = counts + sparse.coo_matrix((weight, pairs), (words, words)).tocsr()
    return (counts + counts.T).tocsr()


def ppmi(
    counts: sparse.csr_matrix, smoothing: float, shift: float
) -> sparse.csr_matrix:
    """Turn counts (V, V) into positive pointwise mutual information (V, V)."""
    rows = np.asarray(counts.sum(axis=1)).ravel()
    columns = np.asarray(counts.sum(axis=0)).ravel() ** smoothing
    matrix = counts.tocoo()
    total = columns.sum()
    value = (
        np.log(matrix.data * total / (rows[matrix.row] * columns[matrix.col])) - shift
    )
    keep = value > 0
    return sparse.csr_matrix(
        (value[keep], (matrix.row[keep], matrix.col[keep])), shape=counts.shape
    )


def build(
    wordnet: Path,
    *,
    dim: int,
    min_count: int,
    window: int,
    smoothing: float,
    shift: float,
    power: float,
    harmonic: bool,
    seed: int,
) -> tuple[list[str], np.ndarray]:
    """Return the words, most frequent first, and their vectors (V, dim) float32."""
    corpus = list(documents(wordnet))
    frequency = Counter(token for tokens in corpus for token in tokens)
    words = sorted(
        (word for word, count in frequency.items() if count >= min_count),
        key=lambda word: (-frequency[word], word),
    )
    index = {word: i for i, word in enumerate(words)}
    ids = [
        np.array([index.get(token, -1) for token in tokens], np.int32)
        for tokens in corpus
    ]
    matrix = ppmi(cooccurrence(ids, len(words), window, harmonic), smoothing, shift)
    start = np.random.default_rng(seed).standard_normal(len(words))
    left, values, _ = svds(matrix.astype(np.float64), k=dim, v0=start)
    order = np.argsort(-values)
    left, values = left[:, order], values[order]
    # The SVD leaves signs open
    left *= np.sign(left[np.abs(left).argmax(axis=0), np.arange(dim)])
    vectors = left * values**power
    vectors /= np.linalg.norm(vectors, axis=1).mean()  # a typical word has norm 1
    # safetensors writes the buffer as it lies: the columns taken in order left it column-major
    return words, np.ascontiguousarray(vectors, dtype=np.float32)


def main() -> None:
    """Build the vectors and write them as float16 safetensors."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--wordnet", type=Path, default=Path("/usr/share/wordnet"))
    parser.add_argument("--out", type=Path, default=OUTPUT)
    parser.add_argument("--dim", type=int, default=50)
    parser.add_argument("--min-count", type=int, default=5)
    parser.add_argument("--window", type=int, default=10)
    parser.add_argument("--smoothing", type=float, default=0.75)
    parser.add_argument("--shift", type=float, default=0.0)
    parser.add_argument("--power", type=float, default=0.0)
    parser.add_argument(
        "--harmonic", action="store_true", help="weight a pair by 1/distance"
    )
    parser.add_argument("--seed", type=int, default=0)
    a = parser.parse_args()
    words, vectors = build(
        a.wordnet, dim=a.dim, min_count=a.min_count, window=a.window, smoothing=a.smoothing,
        shift=a.shift, power=a.power, harmonic=a.harmonic, seed=a.seed,
    )  # fmt: skip
    text = np.frombuffer("\n".join(words).encode(), np.uint8)
    note = (
        "PPMI-SVD of WordNet 3.0 glosses; see WORDNET-LICENSE.txt; built by "
        + Path(__file__).name
    )
    save_file(
        {"vectors": vectors.astype(np.float16), "words": text.copy()},
        a.out,
        {"note": note},
    )
    print(
        f"{len(words)} words x {a.dim} numbers -> {a.out} ({a.out.stat().st_size / 1e6:.2f} MB)"
    )


if __name__ == "__main__":
    main()
