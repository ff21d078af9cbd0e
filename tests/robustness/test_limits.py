"""Files and queries from others: no network, and limits on size."""

import bz2
import gzip
import http.server
import io
import lzma
import threading
import zipfile

import pytest

from knowarm import reading
from knowarm.errors import UserError
from knowarm.knowledge import household, read_graph
from knowarm.knowledge.formats import oxigraph
from knowarm.knowledge.graph.sparql import sparql

RDF = '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" xmlns="http://x/">'


@pytest.fixture(scope="module")
def server():
    """A server that records what is requested."""
    requests = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            requests.append(self.path)
            self.send_response(200)
            self.end_headers()
            self.wfile.write(b'{"@context": {}}')

        do_POST = do_GET

        def log_message(self, *arguments):
            pass

    with http.server.HTTPServer(("127.0.0.1", 0), Handler) as served:
        threading.Thread(target=served.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{served.server_port}/x", requests
        served.shutdown()


@pytest.mark.parametrize(
    "query",
    [
        "SELECT * { SERVICE <URL> { ?s ?p ?o } }",
        "SELECT * { service silent <URL> { ?s ?p ?o } }",
        # In SPARQL a local name may contain an escaped quote: no string begins there.
        "SELECT * { ?s :a\\'b ?o . SERVICE <URL> { ?x ?y ?z } ?u :c\\'d ?v }",
        "SELECT * { ?s ?p 1SERVICE <URL> { ?x ?y ?z } }",
        "SELECT * { FILTER(1<2)SERVICE<URL>{ ?x ?y ?z } FILTER(2>1) }",
        "SELECT * { ?s ?p ?o.SERVICE <URL> { ?x ?y ?z } }",
        "SELECT * FROM <URL> { ?s ?p ?o }",
        "SELECT * FROM NAMED <URL> { GRAPH ?g { ?s ?p ?o } }",
    ],
)
def test_queries_do_not_reach_the_network(server, query):
    url, requests = server
    with pytest.raises(UserError, match="SPARQL query"):
        sparql(household(), query.replace("URL", url))
    assert requests == []


def test_names_that_contain_service_are_no_keyword():
    for name in (":service", "?service", "<http://x/service>", ":room_service"):
        assert sparql(household(), f"ASK {{ {name} ?p ?o }}").columns == ("answer",)


def test_a_json_ld_context_is_not_fetched(server, tmp_path):
    url, requests = server
    local = tmp_path / "local.jsonld"
    local.write_text('{"@context": {"b": "http://b/"}}')
    for context in (url, local.as_uri(), "local.jsonld"):
        path = tmp_path / "a.jsonld"
        path.write_text(f'{{"@context": "{context}", "@id": "http://a/", "b": "x"}}')
        with pytest.raises(UserError, match="context is a remote document"):
            read_graph(path)
    assert requests == []


def test_entities_in_other_documents_are_not_read(tmp_path):
    path, other = tmp_path / "a.rdf", tmp_path / "secret.txt"
    other.write_text("secret")
    path.write_text(
        f'<!DOCTYPE x [<!ENTITY e SYSTEM "{other.as_uri()}">]>{RDF}'
        '<rdf:Description rdf:about="http://a/"><b>&e;</b></rdf:Description></rdf:RDF>'
    )
    with pytest.raises(UserError, match="not well-formed"):
        read_graph(path)


def test_entities_for_namespaces_are_read(tmp_path):
    path = tmp_path / "a.owl"
    path.write_text(
        f'<!DOCTYPE x [<!ENTITY n "http://n/">]>{RDF}<rdf:Description rdf:about="&n;mug">'
        '<isA rdf:resource="&n;cup"/></rdf:Description></rdf:RDF>'
    )
    assert list(read_graph(path)) == [("http://n/mug", "http://x/isA", "http://n/cup")]


def zipped(data):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.tsv", data)
    return file.getvalue()


@pytest.mark.parametrize("method", ["encrypted", "unknown"])
def test_zip_files_that_cannot_be_decompressed(tmp_path, method):
    data = bytearray(zipped(b"mug\tisA\tcup\n"))
    central = data.index(b"PK\1\2")
    if method == "encrypted":
        data[6] |= 1
        data[central + 8] |= 1
    else:
        data[8] = data[central + 10] = 97
    path = tmp_path / "a.tsv.zip"
    path.write_bytes(data)
    with pytest.raises(UserError, match="is damaged or of another format"):
        read_graph(path)


def test_ids_are_ascii_digits(tmp_path):
    for name, text in (("entity", "1\nmug\t²\n"), ("relation", "1\nisA\t0\n"), ("train", "0\n")):
        (tmp_path / f"{name}2id.txt").write_text(text, encoding="utf-8")
    with pytest.raises(UserError, match="expected `name<tab>id`"):
        read_graph(tmp_path)


@pytest.mark.parametrize("suffix", [".gz", ".bz2", ".xz", ".zip"])
def test_compressed_files_that_expand_like_a_bomb(tmp_path, suffix, monkeypatch):
    monkeypatch.setattr(reading, "MAX_JSON", 2**20)
    line = b"mug\tisA\tcup\n"
    compress = {".gz": gzip.compress, ".bz2": bz2.compress, ".xz": lzma.compress, ".zip": zipped}
    path = tmp_path / f"a.tsv{suffix}"
    path.write_bytes(compress[suffix](line * 2**19))
    with pytest.raises(UserError, match="expands to more than"):
        read_graph(path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.jsonld", '{"a:b":' * 5_000 + "1" + "}" * 5_000, "nests too deep"),
        (
            "a.rdf",
            RDF + '<rdf:Description xmlns:x="http://x/" x:a="' + "b" * 2**25 + '"/></rdf:RDF>',
            "buffer",
        ),
    ],
)
def test_documents_that_end_the_parser(tmp_path, name, text, words, monkeypatch):
    monkeypatch.setattr(oxigraph, "SECONDS", 600.0)
    (tmp_path / name).write_text(text)
    with pytest.raises(UserError, match=words):
        read_graph(tmp_path / name)


def test_a_document_that_takes_too_long(tmp_path, monkeypatch):
    monkeypatch.setattr(oxigraph, "SECONDS", 1.0)
    attributes = " ".join(f'x:a{i}="b"' for i in range(200_000))
    document = f'{RDF}<rdf:Description xmlns:x="http://x/" {attributes}/></rdf:RDF>'
    (tmp_path / "a.rdf").write_text(document)
    with pytest.raises(UserError, match="takes more than"):
        read_graph(tmp_path / "a.rdf")


@pytest.mark.slow
def test_queries_that_exhaust_memory_or_time(monkeypatch):
    monkeypatch.setattr(oxigraph, "SECONDS", 600.0)
    monkeypatch.setattr(oxigraph, "MEMORY", 1 << 30)
    doubled = " ".join(f"BIND(CONCAT(?v{i}, ?v{i}) AS ?v{i + 1})" for i in range(40))
    with pytest.raises(UserError, match="SPARQL query: it nests too deep, or needs more than"):
        sparql(household(), f'SELECT * {{ BIND("a" AS ?v0) {doubled} }}')
    crossed = "?a ?b ?c . ?d ?e ?f . ?g ?h ?i . ?j ?k ?l FILTER(?c != ?l)"
    monkeypatch.setattr(oxigraph, "SECONDS", 1.0)
    with pytest.raises(UserError, match="SPARQL query: it takes more than 1 s"):
        sparql(household(), f"SELECT (COUNT(*) AS ?n) {{ {crossed} }}")
    with pytest.raises(UserError, match="longer than 20,000 characters"):
        sparql(household(), "ASK {}" + " " * 20_000)
