import gzip
import zipfile

import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.knowledge import KnowledgeConfig, graph_of, scene_embedding
from knowarm.knowledge.vectors import source_named
from knowarm.knowledge.vectors.source import Coverage, SentencePart
from knowarm.knowledge.vectors.words import (
    WordLookup,
    WordVectors,
    all_forms,
    read_word_vectors,
    word_forms,
)

LINES = [
    "the 1 0 0",
    "mug 0 1 0",
    "light-blue 0 0 1",
    ". . . 1 1 1",
    "color 2 0 0",
    "box 0 2 0",
    "pour 0 0 2",
]


@pytest.fixture
def vectors(tmp_path):
    path = tmp_path / "v.txt"
    path.write_text("\n".join(LINES) + "\n")
    return path


def find(source, label):
    coverage = Coverage()
    return source.find(SentencePart(label, label, False), coverage), coverage


def test_the_text_format(vectors, tmp_path):
    table = read_word_vectors(vectors)
    assert table.words == ("the", "mug", "light-blue", ". . .", "color", "box", "pour")
    assert table.vectors.dtype == np.float32
    assert table.vectors.shape == (7, 3)
    assert table.vectors[1].tolist() == [0, 1, 0]
    some = read_word_vectors(vectors, {"box", "mug", ". . .", "nothing"})
    assert some.words == ("mug", ". . .", "box")
    assert some.ranks.tolist() == [2, 4, 6]
    assert some.size == 7
    text = vectors.read_text()
    (tmp_path / "w2v.vec").write_text("7 3\n" + text.replace("\n", " \n"))
    with gzip.open(tmp_path / "v.txt.gz", "wt") as file:
        file.write(text)
    with zipfile.ZipFile(tmp_path / "v.zip", "w") as archive:
        archive.writestr("v.50d.txt", text)
    for name in ("w2v.vec", "v.txt.gz", "v.zip"):
        again = read_word_vectors(tmp_path / name)
        assert again.words == table.words
        assert (again.vectors == table.vectors).all()
        assert (again.ranks == table.ranks).all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a 1 2 3\nb 1 2\nc 1 2 3\n", "line 2: has 2 numbers, the lines before 3"),
        (
            "a 1.5 2.5\nb 1.5 2.5\nc 1.5 2.5 3.5\n",
            "line 3: has 3 numbers, the lines before 2",
        ),
        ("a 1 2\nb 1 nan\n", "line 2: the vector of 'b' contains a non-finite value"),
        ("a 1 2\nb inf 2\n", "line 2: the vector of 'b' contains a non-finite value"),
        (
            "a 1 2\nb 1 two\n",
            "line 2: the vector of 'b' contains a non-finite value or text",
        ),
        ("hello\nworld\n", "line 1: expected a word and its numbers"),
    ],
)
def test_malformed_files_name_the_line(tmp_path, text, message):
    path = tmp_path / "bad.txt"
    path.write_text(text)
    with pytest.raises(UserError, match=message) as caught:
        read_word_vectors(path)
    assert str(path) in str(caught.value)


def test_other_files(tmp_path):
    with pytest.raises(UserError, match=r"no word-vector file.*glove\.6B\.50d\.txt"):
        read_word_vectors(tmp_path / "none.txt")
    binary = tmp_path / "v.bin"
    binary.write_bytes(
        b"1 2\nmug " + np.array([0.1, -0.3], np.float32).tobytes() + b"\n"
    )
    with pytest.raises(UserError, match="binary vectors are not read"):
        read_word_vectors(binary)
    huge = tmp_path / "huge.txt"
    with huge.open("wb") as file:
        file.truncate(5_000_000_000)
    with pytest.raises(UserError, match=r"huge\.txt: binary vectors are not read"):
        read_word_vectors(huge)
    broken = tmp_path / "v.zip"
    broken.write_bytes(b"PK not a zip")
    with pytest.raises(UserError, match="is damaged or of another format"):
        read_word_vectors(broken)


def test_how_a_label_is_found(vectors):
    source = WordLookup(
        read_word_vectors(vectors), aliases={"irb120": "box", "teacup": "mug"}
    )
    for label, kind, vector in [
        ("mug", "word", [[0, 1, 0]]),
        ("light blue", "joined", [[0, 0, 1]]),
        ("mug box", "words", [[0, 1, 0], [0, 2, 0]]),
        ("mugs", "form", [[0, 1, 0]]),
        ("boxes", "form", [[0, 2, 0]]),
        ("pouring", "form", [[0, 0, 2]]),
        ("colour", "form", [[2, 0, 0]]),
        ("irb120", "alias", [[0, 2, 0]]),
        ("my teacup", "part", [[0, 1, 0]]),
    ]:
        found, coverage = find(source, label)
        assert found.vectors.tolist() == vector, label
        assert coverage.how == {label: kind}
    assert find(source, "my teacup")[1].missing == {"my"}


def test_a_label_of_which_no_word_is_known(vectors):
    table = read_word_vectors(vectors)
    with pytest.raises(UserError, match=r"No word of the label 'zyx qwv'.*aliases="):
        find(WordLookup(table), "zyx qwv")
    found, coverage = find(WordLookup(table, on_missing="skip"), "zyx qwv")
    assert found.vectors.shape == (0, 3)
    assert coverage.describe()["missing_words"] == ["qwv", "zyx"]
    assert coverage.share == 0
    none, _ = find(WordLookup(table, on_missing="hash"), "")
    assert none.vectors.shape == (0, 3)
    found, _ = find(WordLookup(table, on_missing="hash"), "zyx qwv")
    again, _ = find(WordLookup(table, on_missing="hash"), "zyx")
    assert found.vectors.shape == (2, 3)
    assert (found.vectors[0] == again.vectors[0]).all()


def test_every_form_that_is_tried_is_read_from_the_file(vectors):
    for label in ("light blue", "boxes", "colour", "pouring", "irb120"):
        forms = all_forms(label, {"irb120": "box"})
        source = WordLookup(
            read_word_vectors(vectors, forms), aliases={"irb120": "box"}
        )
        assert len(find(source, label)[0].vectors)
    assert word_forms("knives")[:2] == ["knif", "knife"] or "knife" in word_forms(
        "knives"
    )
    assert "berry" in word_forms("berries")
    assert "cut" in word_forms("cutting")
    assert word_forms("glass") == []


def test_a_file_of_vectors_through_the_same_door(vectors, tmp_path):
    graph = graph_of([("mug", "color", "light_blue"), ("box", "color", "the")])
    from knowarm.knowledge.formats import write_graph

    write_graph(graph, tmp_path / "g.ttl")
    config = KnowledgeConfig(
        detail="full", dim=3, source=WordVectors(file=str(vectors)), graph=str(tmp_path / "g.ttl"),
        colour_relation="color",
    )  # fmt: skip
    embedding = scene_embedding(config, [("mug", "light_blue")])
    np.testing.assert_allclose(embedding.vector, [2 / 3, 1 / 3, 1 / 3], rtol=1e-6)


def test_a_random_vector_depends_on_the_word_and_the_file_only(vectors):
    def found(*labels):
        forms = {form for label in labels for form in all_forms(label, {})}
        lookup = WordLookup(read_word_vectors(vectors, forms), on_missing="hash")
        return find(lookup, "zyx")[0].vectors

    alone = found("zyx")
    # Of 1, 1, 1, sqrt 3, 2, 2, 2
    assert np.linalg.norm(alone) == pytest.approx(np.sqrt(3))
    assert (found("zyx", "mug") == alone).all()
    assert (found("zyx", "color", "box") == alone).all()


def test_aliases_are_read_from_the_file_as_they_are_looked_up(vectors):
    aliases = {"IRB120": "Boxes", "teacup": "crate", "crate": "mug"}
    for label, row in (("irb120", [0, 2, 0]), ("teacup", [0, 1, 0])):
        lookup = WordLookup(
            read_word_vectors(vectors, all_forms(label, aliases)), aliases=aliases
        )
        assert find(lookup, label)[0].vectors.tolist() == [row]


def test_short_names_of_files_and_values_that_are_not_taken():
    for name in ("v.txt", "v.txt.gz", "v.txt.bz2", "v.txt.xz", "v.zip"):
        assert source_named(name) == WordVectors(file=name)
    with pytest.raises(UserError, match="'zeros' takes no value, got 'zeros:foo'"):
        source_named("zeros:foo")


@pytest.mark.parametrize("header", ["", "2 3\n"])
@pytest.mark.parametrize("name", ["v.txt", "v.bin"])
def test_text_is_read_behind_a_byte_order_mark_and_under_any_suffix(
    tmp_path, name, header
):
    path = tmp_path / name
    path.write_text(f"\ufeff{header}mug 1 2 3\nbox 4 5 6\n", "utf-8")
    table = read_word_vectors(path, {"mug"})
    assert (table.words, table.vectors.tolist()) == (("mug",), [[1, 2, 3]])
    assert source_named(str(path)) == WordVectors(file=str(path))


def test_a_file_in_this_folder_is_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "v.kv").write_text("mug 1 2 3\n")
    assert source_named("v.kv") == WordVectors(file="v.kv")
