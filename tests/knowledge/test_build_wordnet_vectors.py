"""The script that builds the shipped vectors, on WordNet where it is installed."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file

from knowarm.knowledge import household
from knowarm.knowledge.slots import graph_parts
from knowarm.knowledge.vectors.source import Coverage
from knowarm.knowledge.vectors.words import DATA, SHIPPED, WordLookup, shipped_vectors

ROOT = Path(__file__).parents[2]
WORDNET = Path("/usr/share/wordnet/data.noun")


def cosine(first, second):
    vectors = shipped_vectors("wordnet-gloss-50")
    a, b = (vectors.vectors[vectors.index[word]] for word in (first, second))
    return float(a @ b / np.linalg.norm(a) / np.linalg.norm(b))


def test_the_shipped_vectors_are_whole():
    vectors = shipped_vectors("wordnet-gloss-50")
    assert 20_000 < len(vectors.words) < 30_000
    assert vectors.dim == 50
    assert np.isfinite(vectors.vectors).all()
    assert len(vectors.index) == len(vectors.words)
    assert SHIPPED["wordnet-gloss-50"].stat().st_size < 3_500_000
    assert "Princeton University" in (DATA / "WORDNET-LICENSE.txt").read_text()
    assert vectors.frequencies.sum() == pytest.approx(1, abs=0.05)


def test_the_shipped_vectors_know_the_shipped_graph():
    source, coverage = WordLookup(shipped_vectors("wordnet-gloss-50")), Coverage()
    for part in graph_parts(household(), relation_words=True):
        source.find(part, coverage)
    assert coverage.share == 1.0


def test_likely_words_are_near():
    assert cosine("mug", "cup") > cosine("mug", "hammer") + 0.2
    assert cosine("red", "yellow") > cosine("red", "kitchen") + 0.2
    assert cosine("bottle", "wine") > cosine("bottle", "book")
    text = (ROOT / "benchmarks" / "household_triplets.tsv").read_text()
    triplets = [line.split("\t") for line in text.splitlines()]
    right = sum(cosine(a, b) > cosine(a, c) for a, b, c in triplets)
    assert right >= 0.85 * len(triplets)


@pytest.mark.slow
@pytest.mark.skipif(
    not WORDNET.exists(), reason="Debian's wordnet-base is not installed"
)
def test_the_script_builds_what_is_shipped(tmp_path):
    out = tmp_path / "vectors.safetensors"
    script = ROOT / "scripts" / "build_wordnet_vectors.py"
    subprocess.run(
        [sys.executable, script, "--out", out], check=True, capture_output=True
    )
    built, shipped = load_file(out), load_file(SHIPPED["wordnet-gloss-50"])
    assert (built["words"] == shipped["words"]).all()
    # another BLAS may turn last digits, no more
    np.testing.assert_allclose(
        built["vectors"].astype(np.float32),
        shipped["vectors"].astype(np.float32),
        atol=0.02,
    )
