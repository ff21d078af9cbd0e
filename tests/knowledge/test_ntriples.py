import pytest

from knowarm.errors import UserError
from knowarm.knowledge import read_graph
from knowarm.knowledge.graph.terms import literal, name_of_iri

HARD = r"""# a comment
<http://a.org/x> <http://a.org/p> <http://a.org/y> .
<http://a.org/x>  <http://a.org/p>  <http://a.org/z>.
_:b1 <http://a.org/p> _:b2 . # trailing comment
<http://a.org/x> <http://a.org/p> "plain" .
<http://a.org/x> <http://a.org/p> "tab\t quote\" back\\slash \n \u00e9 \U0001F600" .
<http://a.org/x> <http://a.org/p> "hallo"@de-AT .
	<http://a.org/x>	<http://a.org/p>	"1.5"^^<http://www.w3.org/2001/XMLSchema#decimal>	.
<http://a.org/caf\u00e9> <http://a.org/p> <http://a.org/\U000000e9> .

<urn:knowarm:cereal%20box> <urn:knowarm:isA> <urn:knowarm:box> .
<http://a.org/x> <http://www.w3.org/2000/01/rdf-schema#label> "ex"@en .
<http://a.org/x> <http://www.w3.org/2000/01/rdf-schema#label> "das x"@de .
"""


def rdflib_facts(path):
    """Triples of names as rdflib, the oracle, reads them; blank nodes are renamed."""
    rdflib = pytest.importorskip("rdflib", reason="rdflib, the oracle, is not installed")

    def name(term):
        if isinstance(term, rdflib.Literal):
            return literal(str(term), language=term.language, datatype=term.datatype)
        return f"_:{term}" if isinstance(term, rdflib.BNode) else name_of_iri(str(term))

    parsed = rdflib.Graph().parse(path, format="nt")
    return {tuple(map(name, triple)) for triple in parsed if "label" not in triple[1]}


def test_it_reads_what_rdflib_reads(tmp_path):
    path = tmp_path / "hard.nt"
    path.write_text(HARD)
    ours = read_graph(path)
    theirs = rdflib_facts(path)

    def facts(graph):  # rdflib renames blank nodes
        return {t for t in graph if not t[0].startswith("_:")}

    assert facts(ours) == facts(theirs)
    assert len(ours) == len(theirs) == 9
    assert ours.labels == {"http://a.org/x": "ex"}
    assert ("_:b1", "http://a.org/p", "_:b2") in ours
    assert ("cereal box", "isA", "box") in ours


@pytest.mark.parametrize(
    "line",
    [
        "<http://a> <http://b> <http://c>",
        "<http://a> <http://b> .",
        '"literal" <http://b> <http://c> .',
        "<http://a b> <http://b> <http://c> .",
        '<http://a> <http://b> "open .',
        "@prefix : <http://a> .",
        "<http://a> <http://b> <http://c> . <http://d> <http://e> <http://f> .",
    ],
)
def test_a_malformed_line_is_named(tmp_path, line):
    path = tmp_path / "bad.nt"
    path.write_text(f"<http://a> <http://b> <http://c> .\n{line}\n")
    with pytest.raises(UserError, match=r"bad\.nt, line [23]: not well-formed N-Triples"):
        read_graph(path)


def test_packed_files_and_windows_line_ends(tmp_path):
    import gzip

    path = tmp_path / "a.nt.gz"
    with gzip.open(path, "wt", newline="") as file:
        file.write("<http://a> <http://b> <http://c> .\r\n" * 2)
    assert len(read_graph(path)) == 1
    path.write_bytes(path.read_bytes()[:20])
    with pytest.raises(UserError, match="is damaged or of another format"):
        read_graph(path)


def test_not_utf8(tmp_path):
    path = tmp_path / "latin.nt"
    path.write_bytes(b'<http://a> <http://b> "caf\xe9" .\n')
    with pytest.raises(UserError, match=r"latin\.nt, line 1: not UTF-8"):
        read_graph(path)
