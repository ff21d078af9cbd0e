import pytest

from knowarm.errors import UserError
from knowarm.knowledge import read_graph

CONCEPTNET = "conceptnet-assertions-5.7.0.csv"
ASSERTION = '/a/x\t/r/IsA\t/c/en/mug\t/c/en/cup\t{"weight": 2.0}\n'
TURTLE = "@prefix : <urn:knowarm:> .\n"
OWL = "Prefix(owl:=<http://www.w3.org/2002/07/owl#>)\nOntology(<http://a.org>\n"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        (
            "a.ttl",
            TURTLE + ":mug :isA :cup .\n:mug :hasColor ;;; red\n",
            r"line [34]: not well-formed Turtle.*Correct",
        ),
        (
            "a.ttl",
            TURTLE + ":mug home:isA :cup .\n",
            "line 2: not well-formed Turtle.*home:",
        ),
        ("a.nt", "<http://a> <http://b>\n", "line [12]: not well-formed N-Triples"),
        ("a.nt", '<http://a> <http://b> "caf\xe9" .\n', "line 1: not UTF-8"),
        (
            "a.rdf",
            '<?xml version="1.0"?>\n<a>\n<b>\n',
            "line [34]: not well-formed RDF/XML",
        ),
        ("a.jsonld", '{"@id": "x",\n "y": }\n', "line 2: not well-formed JSON-LD"),
        ("a.owl", OWL, r"line \d: not well-formed OWL functional syntax"),
        ("a.ttl", OWL, r"line \d: not well-formed OWL functional syntax"),
        (
            "a.tsv",
            "mug\tisA\tcup\nmug\tcup\n",
            r"line 2: has 2 columns, but a row has 3 \(head, relation, tail\)",
        ),
        (
            "a.tsv",
            "mug isA cup\n",
            "line 1: has 1 column,.*name the columns in the first line",
        ),
        ("a.tsv", "mug\0\tisA\tcup\n", "line 1: contains a zero byte"),
        ("a.csv", "head,relation,tail\nmug,,cup\n", "line 2: the relation is empty"),
        ("a.csv", 'mug,isA,cup\nmug,isA,"cup\n', "line 2: not well-formed CSV"),
        (
            CONCEPTNET,
            ASSERTION + "/a/x\t/r/IsA\t/c/en/mug\n",
            "line 2: has 3 columns.*has 5",
        ),
        (
            CONCEPTNET,
            ASSERTION.replace("2.0", '"big"'),
            "line 1: the fifth column must be JSON",
        ),
    ],
)
def test_a_malformed_line_is_named(tmp_path, name, text, message):
    path = tmp_path / name
    path.write_text(text, "latin-1")
    with pytest.raises(UserError, match=message) as caught:
        read_graph(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_five_gigabyte_file_of_one_line(tmp_path):
    for name in ("a.tsv", "a.csv"):
        path = tmp_path / name
        with path.open("wb") as file:
            file.truncate(5_000_000_000)  # sparse: takes no room on disk
        with pytest.raises(
            UserError, match=rf"{name}, line 1: the line is longer than"
        ):
            read_graph(path)
        path.unlink()


@pytest.mark.parametrize("name", ["a.nt", "a.ttl", "a.rdf", "a.jsonld"])
def test_five_gigabytes_of_zeros_are_no_rdf(tmp_path, name):
    path = tmp_path / name
    with path.open("wb") as file:
        file.truncate(5_000_000_000)  # sparse: takes no room on disk
    with pytest.raises(UserError, match=rf"{name}, line 1: contains a zero byte"):
        read_graph(path)


def test_files_that_are_none(tmp_path):
    with pytest.raises(UserError, match="There is no graph file"):
        read_graph(tmp_path / "none.ttl")
    with pytest.raises(UserError, match="is no folder of triples"):
        read_graph(tmp_path)
    odd = tmp_path / "graph.xyz"
    odd.touch()
    with pytest.raises(
        UserError, match=r"the suffix '\.xyz' and the content belong to no"
    ):
        read_graph(odd)
    with pytest.raises(UserError, match=r"graph format 'turtel'.*'turtle'"):
        read_graph(odd, "turtel")
    with pytest.raises(UserError, match="is a folder"):
        read_graph(tmp_path, "turtle")


OPENKE = {
    "entity2id.txt": "2\nmug\t0\ncup\t1\n",
    "relation2id.txt": "1\nisA\t0\n",
    "train2id.txt": "1\n0 1 0\n",
}


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("entity2id.txt", "mug\t0\n", "line 1: the first line must be the number"),
        ("entity2id.txt", "2\nmug\t0\nmug\t1\n", "not as many different names"),
        (
            "entity2id.txt",
            "3\nmug\t0\ncup\t1\n",
            "number of lines that follow, 2, got '3'",
        ),
        ("entity2id.txt", "2\nmug\t0\ncup one\n", "line 3: expected `name<tab>id`"),
        ("entity2id.txt", "2\nmug\t0\ncup\t²\n", "line 3: expected `name<tab>id`"),
        ("train2id.txt", "1\n0 1\n", "line 2: expected three ids"),
        ("train2id.txt", f"1\n0 1 {'9' * 12}\n", "line 2: expected three ids"),
        ("train2id.txt", "1\n0 1 ٣\n", "line 2: expected three ids"),
        (
            "train2id.txt",
            "1\n0 7 0\n",
            "line 2: '0 7 0' holds an id that is not among the 2",
        ),
        ("train2id.txt", "2\n0 1 0\n", "number of lines that follow, 1, got '2'"),
    ],
)
def test_malformed_openke_files(tmp_path, name, text, message):
    for file, content in {**OPENKE, name: text}.items():
        (tmp_path / file).write_text(content, "utf-8")
    with pytest.raises(UserError, match=message):
        read_graph(tmp_path)
