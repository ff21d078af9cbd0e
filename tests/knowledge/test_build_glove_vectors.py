"""The shipped vectors of GloVe: the numbers of glove.6B.50d, for every label of a shipped graph."""

import numpy as np
import pytest
from safetensors.numpy import save_file

from knowarm.knowledge.formats import SHIPPED as GRAPHS
from knowarm.knowledge.formats import read_graph
from knowarm.knowledge.slots import graph_parts
from knowarm.knowledge.vectors import words
from knowarm.knowledge.vectors.source import Coverage
from knowarm.knowledge.vectors.words import DATA, WordLookup, shipped_vectors

GLOVE = "glove-6b-50"
PUBLISHED = {
    "of": (4, [0.70853, 0.57088, -0.4716, 0.18048]),
    "red": (640, [-0.12878, 0.8798, -0.60694, 0.12934]),
}
"""Place and first numbers of two words in the published file glove.6B.50d.txt."""


def test_the_vectors_are_those_of_the_published_file():
    table = shipped_vectors(GLOVE)
    assert table.size == 400_000
    assert table.dim == 50
    assert np.all(np.diff(table.ranks) > 0)
    for word, (rank, numbers) in PUBLISHED.items():
        row = table.index[word]
        assert table.ranks[row] == rank
        assert table.vectors[row, :4].tolist() == pytest.approx(numbers, abs=1e-6)


def test_frequencies_are_those_of_the_whole_file():
    table = shipped_vectors(GLOVE)
    frequencies = dict(zip(table.words, table.frequencies, strict=True))
    assert frequencies["of"] == pytest.approx(
        1 / (4 * (np.log(400_000) + 0.5772)), 1e-3
    )
    assert table.frequencies.sum() < 0.5  # the words left out have the rest


@pytest.mark.parametrize("graph", GRAPHS)
def test_they_know_every_label_of_the_shipped_graphs(graph):
    source = WordLookup(shipped_vectors(GLOVE))
    coverage = Coverage()
    for part in graph_parts(read_graph(graph), relation_words=True):
        source.find(part, coverage)
    assert coverage.share == 1.0


def test_the_licence_is_shipped_with_them():
    text = (DATA / "GLOVE-LICENSE.txt").read_text("utf-8")
    assert "Public Domain Dedication and License (PDDL)" in text
    assert f"the vectors of {len(shipped_vectors(GLOVE).words)} words" in text


def test_ranks_and_size_may_be_left_out(tmp_path, monkeypatch):
    path = tmp_path / "v.safetensors"
    letters = np.frombuffer(b"mug\nred", np.uint8).copy()
    save_file({"vectors": np.ones((2, 3), np.float32), "words": letters}, path)
    monkeypatch.setitem(words.SHIPPED, "two", path)
    table = shipped_vectors.__wrapped__("two")
    assert table.size == 2
    assert table.ranks.tolist() == [1, 2]
