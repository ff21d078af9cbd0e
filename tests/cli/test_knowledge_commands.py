import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file

from knowarm.cli.main import main
from knowarm.knowledge import household
from knowarm.knowledge.formats import HOUSEHOLD

ROOT = Path(__file__).parents[2]


def run(capsys, *words):
    code = main(["knowledge", *map(str, words)])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def test_show(capsys, tmp_path):
    out = tmp_path / "show.json"
    objects = ("--objects", "mug", "bottle", "cereal_box")
    code, text, _ = run(capsys, "show", *objects, "--detail", "full", "--json", out)
    assert code == 0
    for piece in (
        "hasColor",
        "light_blue",
        "mug has color",
        "shape (300,)",
        "norm",
        "100 %",
    ):
        assert piece in text.replace("\n", " ").replace("\n", " ")
    values = json.loads(out.read_text())
    assert values["shape"] == [300]
    assert len(values["vector"]) == 300
    assert values["constant"]
    assert ["mug", "hasColor", "red"] in values["triples"]
    assert "mug has color red" in values["sentences"]["red mug"]
    code, text, _ = run(capsys, "show", "--agent", "target", "--colours", "fixed")
    assert "shape (50,)" in text
    assert "privileged" in text


def test_show_the_vector_of_a_run(capsys, tmp_path):
    out, zoo = tmp_path / "run.json", ROOT / "zoo" / "irb120-full-fast"
    code, _, _ = run(capsys, "show", "--agent", zoo, "--json", out)
    assert code == 0
    norm = json.loads((zoo / "provenance.json").read_text())["knowledge"]["norm"]
    values = json.loads(out.read_text())
    assert np.linalg.norm(values["vector"]) == pytest.approx(norm, rel=1e-6)
    code, _, error = run(capsys, "show", "--agent", zoo, "--objects", "mug")
    assert code == 2
    assert "leave out --agent" in error


def test_show_what_the_graph_of_an_agent_says_that_is_told_of_questions(
    capsys, tmp_path
):
    out, zoo = tmp_path / "run.json", ROOT / "zoo" / "irb120-choose-answers-fast"
    code, text, _ = run(capsys, "show", "--agent", zoo, "--json", out)
    assert code == 0
    assert "told of questions, not of objects" in text
    code, text, _ = run(capsys, "show", "--agent", "subgraph")
    assert code == 0
    assert "cereal_box" not in text  # of the default objects, those of the graph
    assert "bottle" in text
    assert "bias" not in text  # what it is told differs by question
    values = json.loads(out.read_text())
    assert ["mug", "usedFor", "drinking"] in values["triples"]
    assert "ceramic" in values["sentences"]["mug"]
    code, text, _ = run(capsys, "embed", "--agent", zoo)
    assert code == 0
    assert "26 slots of 50 numbers" in text


def test_subgraph(capsys, tmp_path):
    out = tmp_path / "mug.ttl"
    code, text, _ = run(capsys, "subgraph", "--objects", "mug", "--out", out)
    assert code == 0
    assert "ceramic" in text
    code, text, _ = run(
        capsys,
        "subgraph",
        "--graph",
        out,
        "--sparql",
        "SELECT ?c WHERE {:mug :hasColor ?c}",
    )
    assert code == 0
    assert "blue" in text
    assert "red" in text
    query = tmp_path / "q.rq"
    query.write_text("CONSTRUCT {?x :isA :y} WHERE {?x :hasColor :red}")
    found = tmp_path / "found.json"
    code, *_ = run(capsys, "subgraph", "--sparql", query, "--json", found)
    assert ["mug", "isA", "y"] in json.loads(found.read_text())["facts"]
    code, *_ = run(capsys, "subgraph", "--minus", out, "--json", found)
    assert json.loads(found.read_text())["triples"] == len(household()) - 15
    code, *_ = run(
        capsys, "subgraph", "--graph", out, "--union", HOUSEHOLD, "--json", found
    )
    assert json.loads(found.read_text())["triples"] == len(household())
    code, text, _ = run(capsys, "subgraph", "--statistics", "--json", found)
    assert code == 0
    assert json.loads(found.read_text())["triples"] > 400
    assert "orange" in text  # a fruit and a colour share the label


def test_embed(capsys, tmp_path):
    for suffix in (".npy", ".safetensors"):
        code, text, _ = run(
            capsys, "embed", "--agent", "full+", "--out", tmp_path / f"v{suffix}"
        )
        assert code == 0
        assert "6 slots of 50 numbers" in text
    slots = load_file(tmp_path / "v.safetensors")["slots"]
    np.testing.assert_array_equal(np.load(tmp_path / "v.npy"), slots)


def test_fit(capsys, tmp_path):
    model, fitted = tmp_path / "m.safetensors", tmp_path / "fit.json"
    options = ("--model", "complex", "--dim", "16", "--epochs", "30")
    code, text, _ = run(capsys, "fit", *options, "--out", model, "--json", fitted)
    assert code == 0
    mrr = json.loads(fitted.read_text())["valid_mrr"]
    assert f"validation MRR {mrr:.4f}." in text
    assert 0.1 < mrr <= 1
    code, text, _ = run(capsys, "embed", "--source", model, "--dim", "16")
    assert "6 slots of 16 numbers" in text


def test_a_long_fit_says_how_far_it_is_between_validations(capsys, monkeypatch):
    monkeypatch.setattr("knowarm.cli.knowledge.fit.SILENT_S", 0.0)
    _, text, _ = run(capsys, "fit", "--epochs", "3", "--evaluate-every", "3")
    assert re.findall(r"epoch (\d) of 3: .*, at most [\d.]+ min left", text) == [
        "1",
        "2",
        "3",
    ]


def test_probe(capsys, tmp_path):
    out = tmp_path / "probe.json"
    code, text, _ = run(capsys, "probe", "--json", out)
    assert code == 0
    assert "Warning: red mug and blue mug are nearly the same" in text
    code, text, _ = run(capsys, "probe", "--agent", "full+", "--json", out)
    assert "Every pair of facets can be distinguished" in text
    assert json.loads(out.read_text())["recovered"]["colour"]["task"] == 1.0
    code, text, _ = run(capsys, "probe", "--agent", "zeros")
    assert "Nothing to recover" in text


def test_sources_by_short_name_and_by_field(capsys, tmp_path):
    code, text, _ = run(capsys, "embed", "--source", "zeros", "--dim", "9")
    assert code == 0
    assert "6 slots of 9 numbers" in text
    vectors = tmp_path / "v.txt"
    vectors.write_text("mug 1 0 0\nred 0 1 0\nblue 0 0 1\n")
    options = ("--objects", "mug", "--dim", "3", "--on-missing", "skip")
    code, short, _ = run(capsys, "embed", f"--source={vectors}", *options)
    assert code == 0
    code, field, _ = run(capsys, "embed", "--source.file", vectors, *options)
    assert (code, field) == (0, short)
    code, _, error = run(
        capsys, "embed", "--source", "random", "--source.matches.name", "none"
    )
    assert code == 2
    assert "shipped word vectors 'none'" in error


def test_draw(capsys, tmp_path):
    out = tmp_path / "g.svg"
    code, *_ = run(capsys, "draw", "--out", out, "--objects", "mug", "--hops", "2")
    assert code == 0
    ET.parse(out)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("show", "--objects", "mugg"), "Did you mean 'mug'"),
        (("show", "--agent", "ful"), "Did you mean 'full'"),
        (("show", "--source", "none.txt"), "no word-vector file none.txt"),
        (("show", "--source", "zero"), "Did you mean 'zeros'"),
        (("show", "--source"), "--source needs a name"),
        (("show", "--graph", "none.ttl"), "no graph file none.ttl"),
        (("show", "--json", "/proc/none/x.json"), "Choose another path for --json"),
        (("subgraph", "--graph", "none.ttl"), "no graph file none.ttl"),
        (("subgraph", "--out", "a.xml"), "graphs are written as"),
        (("embed", "--out", "a.txt"), "vectors are written as"),
        (("fit", "--model", "analog"), "Did you mean 'analogy'"),
        (("fit", "--out", "a.pt"), "written as .safetensors"),
        (("fit", "--out", "/proc/none/a.safetensors"), "Choose another path for --out"),
        (("draw", "--out", "/proc/none/a.svg"), "Cannot write"),
        (("show", "--objects", "\udcff"), r"Unknown entity '\udcff'"),
        (
            ("queries", "--objects-per-episode", "0"),
            "objects_per_episode must be at least 1",
        ),
        (("queries", "--seed", "-1"), "Queries.seed must lie between 0"),
        (
            ("subgraph", "--objects", "mug", "--max-degree", "-1"),
            "max_degree must be at least 0",
        ),
        (("fit", "--seed", "-1"), "seed must lie between 0"),
        (("fit", "--batch-size", "0"), "batch_size must be at least 1"),
        (("sho",), "Did you mean 'show'"),
    ],
)
def test_mistakes_end_in_one_line_and_code_2(capsys, words, message):
    code, _, error = run(capsys, *words)
    assert code == 2
    assert message in error
    assert error.count("\n") == 1


def test_queries(capsys, tmp_path):
    out = tmp_path / "queries.json"
    code, text, _ = run(capsys, "queries", "--json", out)
    assert code == 0
    assert "409 queries: 49 of one condition" in text
    values = json.loads(out.read_text())
    assert values["conditions"]["usedFor learning"] == ["book", "globe"]
    assert values["splits"]["S1"] == values["splits"]["training"]
    assert len(values["held_out"]["S3"]) == 6
    assert values["empty"] == {}
    code, _, _ = run(capsys, "queries", "--split", "S4", "--json", out)
    asked = json.loads(out.read_text())["questions"]
    assert all(
        any(value in query for value in values["held_out"]["S4"]) for query in asked
    )
    code, text, _ = run(capsys, "queries", "--agent", "subgraph", "--json", out)
    assert json.loads(out.read_text())["rank_correlation"] > 0.4
    for control in ("subgraph-shuffled", "query-random"):
        run(capsys, "queries", "--agent", control, "--json", out)
        assert abs(json.loads(out.read_text())["rank_correlation"]) < 0.2
    code, text, _ = run(capsys, "queries", "--agent", "query-onehot")
    assert "all conditions are equally similar" in text
    code, _, error = run(capsys, "queries", "--agent", "full")
    assert code == 2
    assert "Unknown agent with knowledge of queries 'full'" in error


def test_queries_of_a_graph_of_the_user(capsys, tmp_path):
    graph = tmp_path / "mine.csv"
    uses = zip("abcdef", "uuvvww", strict=True)
    graph.write_text("".join(f"{name},usedFor,{use}\n" for name, use in uses))
    code, text, _ = run(
        capsys, "queries", "--graph", graph, "--colours", "red", "blue", "green"
    )
    assert code == 0
    assert "No S3 (objects that training never showed): 5 of the 6 objects" in text
    code, _, error = run(capsys, "queries", "--graph", graph, "--split", "S4")
    assert code == 2
    assert "S4" in error
    assert "of the objects whose values can be held out, 0 can stand" in error
    code, _, error = run(capsys, "queries", "--graph", graph, "--objects", "a", "x")
    assert code == 2
    assert "says nothing about the object 'x'" in error


def test_queries_of_an_ontology_are_limited_and_show_their_progress(capsys, tmp_path):
    """4,600 triples with 1,600 entities that might be objects: each line that limits is true."""
    graph = tmp_path / "ontology.csv"
    lines = []
    for number in range(1600):
        lines.append(f"c{number:04},subClassOf,k{number % 40}\n")
        lines.append(f"c{number:04},affords,a{number % 8}\n")
        if number < 1400:
            lines.append(f"c{number:04},comment,n{number}\n")
    graph.write_text("".join(lines))
    out = tmp_path / "queries.json"
    words = ("queries", "--graph", graph, "--json", out)
    code, text, _ = run(capsys, *words, "--most-objects", "240")
    assert code == 0
    assert (
        "1,600 entities are heads of triples and tails of none. The first 240" in text
    )
    assert "objects: c0000 to c0239. --objects names others" in text
    for step in (
        "about 240 objects",
        "S3 holds out",
        "of training, out of",
        "ions of S5",
    ):
        assert sum(step in line for line in text.splitlines()) == 1
    values = json.loads(out.read_text())
    for condition in ("affords a3", "subClassOf k39", "comment n7"):
        assert condition in text
    assert len(values["conditions"]) == 240 + 40 + 8 + 9
    names = values["conditions"]["affords a3"]
    assert names == [f"c{number:04}" for number in range(3, 240, 8)]
    assert len(names) == 30  # the most that a line names
    cells = " ".join(text.replace("│", " ").split())  # whatever the terminal's width
    assert ", ".join(names) in cells
    shown = values["conditions"]["hasColor red"]
    assert len(shown) == 240
    # Named objects are not limited, and few of them show no progress.
    named = (*words, "--objects", "c0000", "c0001", "c0008", "c0041", "--most-objects")
    code, text, _ = run(capsys, *named, "2", "--objects-per-episode", "2")
    assert code == 0
    assert "..." not in text
    assert "are taken" not in text


def test_rows_and_objects_beyond_the_limits_are_counted(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("knowarm.cli.knowledge.queries.MOST_ROWS", 10)
    monkeypatch.setattr("knowarm.cli.knowledge.queries.MOST_OBJECTS", 2)
    out = tmp_path / "queries.json"
    for words in (("queries",), ("queries", "--split", "S1")):
        code, text, _ = run(capsys, *words, "--json", out)
        assert code == 0
        values = json.loads(out.read_text())
        rows = values.get("conditions") or values["questions"]
        assert f"... and {len(rows) - 10} more; --json FILE writes all." in text
        printed = [line for line in text.splitlines() if line.startswith("│")][:10]
        for line, names in zip(printed, rows.values(), strict=False):
            if len(names) > 2 and "│ all" not in line:
                assert f"and {len(names) - 2} more " in " ".join(line.split())
            elif "│ all" not in line:
                assert "more" not in line


def test_the_example_of_an_own_graph(capsys, tmp_path):
    """The commands show what the tutorial says."""
    example = ROOT / "examples" / "own_graph" / "tidy.csv"
    tutorial = (ROOT / "docs" / "tutorials" / "own-graph.md").read_text()
    assert "89 queries: 17 of one condition" in tutorial
    out = tmp_path / "queries.json"
    code, text, _ = run(capsys, "queries", "--graph", example, "--json", out)
    assert code == 0
    assert "89 queries: 17 of one condition" in text
    assert set(json.loads(out.read_text())["empty"]) == {"S3"}
    edited = tmp_path / "edited.csv"
    changed = ("book,ownedBy,grandmother", "book,ownedBy,grandfather")
    edited.write_text(example.read_text().replace(*changed))
    run(
        capsys,
        "queries",
        "--graph",
        example,
        "--edited",
        edited,
        "--split",
        "S5",
        "--json",
        out,
    )
    questions = json.loads(out.read_text())["questions"]
    assert set(map(tuple, questions.values())) == {("book",)}
    assert all(query.startswith("ownedBy grandfather") for query in questions)


def test_graphs_by_name_and_by_path(capsys, tmp_path, monkeypatch):
    out = tmp_path / "out.json"
    run(
        capsys,
        "subgraph",
        "--graph",
        "household",
        "--minus",
        "household",
        "--json",
        out,
    )
    assert json.loads(out.read_text())["triples"] == 0
    code, _, _ = run(capsys, "subgraph", "--union", "objects", "--json", out)
    assert code == 0
    monkeypatch.chdir(tmp_path)
    files = {
        "entity": "2\nmug\t0\ncup\t1\n",
        "relation": "1\nisA\t0\n",
        "train": "1\n0 1 0\n",
    }
    (tmp_path / "families").mkdir()
    for name, text in files.items():
        (tmp_path / "families" / f"{name}2id.txt").write_text(text)
    for graph, triples in (("./families", 1), ("families", 2084)):
        run(capsys, "subgraph", "--graph", graph, "--json", out)
        assert json.loads(out.read_text())["triples"] == triples


def test_entity_names_of_objects_that_are_no_targets(capsys, tmp_path):
    out = tmp_path / "out.json"
    options = ("--objects", "cup", "--entity-names", "cup", "mug", "--json", out)
    code, _, _ = run(capsys, "show", *options)
    assert code == 0
    assert list(json.loads(out.read_text())["sentences"]) == ["blue cup", "red cup"]


def test_probe_of_a_real_source_without_anything_to_recover(capsys, tmp_path):
    graph = tmp_path / "g.csv"
    graph.write_text("mug,hasColor,red\nbottle,hasColor,blue\n")
    options = ("--graph", graph, "--objects", "mug", "bottle", "--colours", "fixed")
    code, text, _ = run(capsys, "probe", *options, "--entity-names", "yellow", "blue")
    assert code == 0
    assert "no object, colour or value describes two facets" in text.replace("\n", " ")


def test_query_files(capsys, tmp_path):
    query = tmp_path / "q.rq"
    query.write_bytes(b"\xef\xbb\xbfASK { :mug ?p ?o }")
    assert "yes" in run(capsys, "subgraph", "--sparql", query)[1]
    query.write_bytes("ASK { :café ?p ?o }".encode("latin1"))
    code, _, error = run(capsys, "subgraph", "--sparql", query)
    assert code == 2
    assert "one SPARQL query in UTF-8" in error
