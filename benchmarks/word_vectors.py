"""Agreement of word vectors with similarities as people see them.

Household triplets (in this folder, written for this project): is the first word nearer to the
second than to the third? Similarity sets, such as WordSim353, SimLex999 or MEN, are files of
`word word score` lines; the rank correlation with their scores is printed. Reading time is that of
a made-up file of 400,000 words x 50 for the words of the shipped graph.

    python -m benchmarks.word_vectors --similarity EN-WS-353-ALL.txt EN-SIMLEX-999.txt
    python -m benchmarks.word_vectors --vectors glove.6B.50d.txt
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from knowarm.cli.tables import print_table
from knowarm.knowledge import household
from knowarm.knowledge.slots import graph_parts
from knowarm.knowledge.vectors.words import (
    WordTable,
    all_forms,
    read_word_vectors,
    shipped_vectors,
)

TRIPLETS = Path(__file__).parent / "household_triplets.tsv"
WORDS, DIM = 400_000, 50


def cosine(vectors: WordTable, first: str, second: str) -> float | None:
    """Return the cosine of two words, or None where one is unknown."""
    if first not in vectors.index or second not in vectors.index:
        return None
    a, b = (
        vectors.vectors[vectors.index[word]].astype(np.float64)
        for word in (first, second)
    )
    return float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))


def triplets(vectors: WordTable) -> tuple[int, int, list[str]]:
    """Return how many triplets are right, how many there are, and the wrong ones."""
    lines = [line.split("\t") for line in TRIPLETS.read_text().splitlines()]
    wrong = []
    for a, b, c in lines:
        near, far = cosine(vectors, a, b), cosine(vectors, a, c)
        if near is None or far is None or near <= far:
            wrong.append(f"{a}: {b} < {c}")
    return len(lines) - len(wrong), len(lines), wrong


def similarity(vectors: WordTable, path: Path) -> tuple[float, float]:
    """Return Spearman's correlation with people's scores, and the share of pairs known."""
    pairs = [line.split() for line in path.read_text().splitlines() if line.strip()]
    scored = [(cosine(vectors, p[0].lower(), p[1].lower()), float(p[2])) for p in pairs]
    known = [(ours, theirs) for ours, theirs in scored if ours is not None]
    ours, theirs = zip(*known, strict=True)
    return float(spearmanr(ours, theirs).statistic), len(known) / len(pairs)


def reading_time(repeats: int = 3) -> float:
    """Return the best time to read the shipped graph's words from 400,000 x 50 numbers [s]."""
    words = list(shipped_vectors("wordnet-gloss-50").words)
    words += [f"filler{i}" for i in range(WORDS - len(words))]
    numbers = np.random.default_rng(0).standard_normal((WORDS, DIM)).round(5)
    parts = graph_parts(household(), relation_words=True)
    forms = {form for part in parts for form in all_forms(part.label, {})}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "vectors.txt"
        with path.open("w") as file:
            for word, row in zip(words, numbers.tolist(), strict=True):
                file.write(f"{word} {' '.join(map(str, row))}\n")
        times = []
        for _ in range(repeats):
            start = time.perf_counter()
            read_word_vectors(path, forms)
            times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--vectors", type=Path, help="a file; left out: the shipped ones"
    )
    parser.add_argument("--similarity", type=Path, nargs="*", default=[])
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    shipped = arguments.vectors is None
    vectors = (
        shipped_vectors("wordnet-gloss-50")
        if shipped
        else read_word_vectors(arguments.vectors)
    )
    right, count, wrong = triplets(vectors)
    rows = [("household triplets", f"{right} of {count}", 1.0)]
    values = {"triplets_right": right, "triplets": count, "wrong": wrong}
    for path in arguments.similarity:
        correlation, known = similarity(vectors, path)
        rows.append((path.stem, f"{correlation:.3f}", known))
        values[path.stem] = {"spearman": correlation, "known": known}
    values["read_400000x50_s"] = reading_time()
    rows.append(("reading 400,000 x 50", f"{values['read_400000x50_s']:.2f} s", 1.0))
    print_table(
        f"{vectors.name}: {vectors.size:,} words", ["what", "value", "known"], rows
    )
    print("Wrong triplets:", "; ".join(wrong) or "none")
    if arguments.json:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps(values, indent=2) + "\n")


if __name__ == "__main__":
    main()
