import json
import os
import subprocess
import sys
from contextlib import redirect_stdout
from io import StringIO

import numpy as np
import pytest

from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.knowledge import (
    FULL,
    KnowledgeConfig,
    graph_of,
    scene_embedding,
    scene_sentences,
    scene_subgraph,
)
from knowarm.knowledge.vectors.placebos import RandomVectors, ShuffledGraph, WrongObject
from knowarm.knowledge.vectors.words import WordVectors
from tests.knowledge.helpers import KNOWLEDGE


def test_the_papers_sizes(facets, fixed_facets):
    assert scene_embedding(KNOWLEDGE["partial"], facets).dim == 150
    assert scene_embedding(KNOWLEDGE["partial"], fixed_facets).dim == 150
    assert scene_embedding(KNOWLEDGE["full"], fixed_facets).dim == 150
    assert scene_embedding(KNOWLEDGE["full"], facets).dim == 300


@pytest.mark.parametrize("agent", KNOWLEDGE)
def test_every_agent_gives_a_finite_table_of_its_size(agent, facets):
    embedding = scene_embedding(KNOWLEDGE[agent], facets)
    table = embedding.table(facets)
    assert table.shape == (6, embedding.dim)
    assert table.dtype == np.float32
    assert np.isfinite(table).all()
    assert embedding.constant == (len(np.unique(table, axis=0)) == 1)
    told = embedding.scope == "target" and not embedding.constant
    assert embedding.privileged == told
    json.dumps(to_dict(embedding.describe()))


def test_scene_rows_are_the_vector_and_target_rows_are_slots(facets):
    scene = scene_embedding(KNOWLEDGE["full"], facets)
    assert (scene.table(facets) == scene.vector).all()
    target = scene_embedding(KNOWLEDGE["target"], facets)
    assert (target.table(facets) == target.matrix).all()
    assert (target.table(facets[::-1]) == target.matrix[::-1]).all()
    with pytest.raises(UserError, match="No slot describes 'green mug'"):
        target.table([("mug", "green")])


def test_a_slot_is_the_mean_of_the_words_of_its_sentence(facets):
    from knowarm.knowledge.vectors.words import shipped_vectors

    words = shipped_vectors("wordnet-gloss-50")
    text = scene_sentences(KNOWLEDGE["full"], facets)["red mug"]
    rows = [words.index[word] for word in text.split()]
    expected = words.vectors[rows].mean(axis=0)
    slot = scene_embedding(KNOWLEDGE["full"], facets).matrix[0]
    np.testing.assert_allclose(slot, expected, rtol=1e-5)


def test_partial_says_no_colour_and_full_says_its_own(facets):
    partial = scene_sentences(KNOWLEDGE["partial"], facets)
    assert list(partial) == ["mug", "bottle", "cereal box"]
    assert "color" not in partial["mug"]
    full = scene_sentences(KNOWLEDGE["full"], facets)
    assert "has color red" in full["red mug"]
    assert "blue" not in full["red mug"]
    assert ("mug", "hasColor", "blue") in scene_subgraph(KNOWLEDGE["full"], facets)


def test_placebos_copy_the_real_shape_and_norm(facets):
    real = scene_embedding(KNOWLEDGE["full"], facets)
    lengths = np.linalg.norm(real.matrix, axis=1)
    for agent in ("random", "onehot", "shuffled", "wrong-object"):
        placebo = scene_embedding(KNOWLEDGE[agent], facets)
        np.testing.assert_allclose(
            np.linalg.norm(placebo.matrix, axis=1), lengths, rtol=1e-5
        )
    assert not scene_embedding(KNOWLEDGE["zeros"], facets).vector.any()
    for agent in ("shuffled", "wrong-object"):
        placebo = scene_embedding(KNOWLEDGE[agent], facets)
        assert placebo.matrix.shape == real.matrix.shape
        assert not np.allclose(placebo.matrix, real.matrix, atol=1e-3)
        assert len(np.unique(placebo.matrix, axis=0)) == 6


def test_the_seed_decides_a_placebo(facets):
    def vector(source, seed):
        config = KnowledgeConfig(detail="full", source=source, seed=seed)
        return scene_embedding(config, facets).vector

    for source in (RandomVectors(), ShuffledGraph(), WrongObject()):
        assert (vector(source, 1) == vector(source, 1)).all()
        assert (vector(source, 1) != vector(source, 2)).any()


@pytest.mark.parametrize("kind", [RandomVectors, ShuffledGraph, WrongObject])
def test_placebos_are_drawn_anew_per_training_seed_and_seed_of_the_knowledge(
    facets, kind
):
    def vector(seed, run_seed):
        config = KnowledgeConfig(detail="full", source=kind(), seed=seed)
        return scene_embedding(config, facets, run_seed=run_seed).vector.tobytes()

    drawn = [vector(seed, run_seed) for seed in range(2) for run_seed in range(3)]
    # Few objects have as many colours as those of the task: two draws of them can be equal.
    assert len(set(drawn)) >= (4 if kind is WrongObject else len(drawn))
    assert vector(1, 2) == drawn[5]


def test_real_vectors_do_not_depend_on_the_training_seed(facets):
    vectors = [scene_embedding(FULL, facets, run_seed=seed).vector for seed in range(2)]
    np.testing.assert_array_equal(*vectors)


def test_wrong_objects_are_not_in_the_task(facets):
    for sentence in scene_sentences(KNOWLEDGE["wrong-object"], facets).values():
        assert sentence.split()[0] not in ("mug", "bottle", "cereal")


def test_full_plus_tells_all_facets_apart(facets):
    unit = scene_embedding(KNOWLEDGE["full+"], facets).matrix
    cosine = unit @ unit.T
    assert cosine[~np.eye(6, dtype=bool)].max() < 0.9
    paper = scene_embedding(KNOWLEDGE["full"], facets).matrix
    paper = paper / np.linalg.norm(paper, axis=1, keepdims=True)
    assert (paper @ paper.T)[0, 1] > 0.99


def test_errors_name_what_is_known(facets):
    with pytest.raises(UserError, match="Did you mean 'mug'"):
        scene_embedding(KNOWLEDGE["full"], [("mugg", "red")])
    with pytest.raises(UserError, match=r"can be 'pink'.*blue, red"):
        scene_embedding(KNOWLEDGE["full"], [("mug", "pink")])
    with pytest.raises(UserError, match="shipped word vectors 'wordnet'"):
        scene_embedding(
            KnowledgeConfig(detail="full", source=WordVectors(name="wordnet")), facets
        )
    with pytest.raises(UserError, match=r"expects 60.*set dim to 50"):
        scene_embedding(KnowledgeConfig(detail="full", dim=60), facets)
    with pytest.raises(
        UserError, match=r"colour relation 'paintedIn'.*colour_relation"
    ):
        scene_embedding(
            KnowledgeConfig(detail="full", colour_relation="paintedIn"), facets
        )
    with pytest.raises(UserError, match="between 0 and 1"):
        scene_embedding(KnowledgeConfig(detail="full", colour_share=2.0), facets)
    with pytest.raises(UserError, match="subgraph of mug is empty"):
        scene_embedding(KnowledgeConfig(detail="partial", hops=0), facets)


def test_the_same_bytes_in_any_process(facets):
    code = (
        "import hashlib; from knowarm.knowledge import *; "
        "from tests.knowledge.helpers import KNOWLEDGE\n"
        "from tests.tiny import FACETS\n"
        "for n in ('full', 'full+', 'shuffled', 'wrong-object', 'random', 'analogy'):\n"
        "    e = scene_embedding(KNOWLEDGE[n], FACETS)\n"
        "    print(n, hashlib.sha256(e.vector.tobytes()).hexdigest(), e.sentences[0])\n"
    )

    env = {
        **os.environ,
        "PYTHONHASHSEED": "12345",
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    with redirect_stdout(StringIO()) as here:
        exec(code, {})
    assert done.stdout == here.getvalue()


PLUS = KNOWLEDGE["full+"]


def test_one_colour_alone_can_be_described():
    graph = graph_of([("mug", "hasColor", "red"), ("bottle", "hasColor", "red")])
    found = scene_embedding(
        PLUS, [("mug", "red"), ("bottle", "red")], graph=graph
    ).matrix
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, rtol=1e-6)
    assert found[0] @ found[1] < 0.99


def test_an_object_may_have_the_name_of_its_colour():
    names = ("orange", "mug")
    graph = graph_of([(n, "hasColor", c) for n in names for c in ("orange", "red")])
    facets = [(n, c) for n in names for c in ("orange", "red")]
    found = scene_embedding(PLUS, facets, graph=graph).matrix
    cosine = found @ found.T
    assert 0.5 < cosine[0, 2] < 0.99  # the orange and the mug, both in orange
    assert cosine[1, 2] < cosine[0, 2]


@pytest.mark.parametrize("kind", [ShuffledGraph, WrongObject])
def test_what_is_shown_is_what_a_run_was_given(facets, kind):
    config = KnowledgeConfig(detail="full", source=kind())
    for seed in (0, 3):
        said = tuple(scene_sentences(config, facets, run_seed=seed).values())
        assert said == scene_embedding(config, facets, run_seed=seed).sentences
    assert scene_subgraph(config, facets, run_seed=3) != scene_subgraph(config, facets)


@pytest.mark.parametrize(
    "values",
    [{"seed": -1}, {"dim": 0}, {"hops": -1}, {"max_degree": -1}, {"colour_share": 1.5}],
)
def test_numbers_of_the_config_are_checked(values):
    with pytest.raises(UserError, match=f"{next(iter(values))} must"):
        KnowledgeConfig(detail="full", **values)
