"""Files and queries from others: no network, no other files."""

import http.server
import io
import os
import re
import threading
import time
import zipfile

import pytest

from knowarm.errors import UserError
from knowarm.knowledge import household, read_graph
from knowarm.knowledge.queries.sparql import sparql

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
        "# {\nSELECT * FROM <URL> { ?s ?p ?o }",
        "SELECT * FROM NAMED <URL> { GRAPH ?g { ?s ?p ?o } }",
        "SELECT * FROM<URL> { ?s ?p ?o }",
        "DESCRIBE <URL>FROM<URL>",
        # What begins no comment and no string: a part of an IRI
        "SELECT * { SERVICE <URL\\u0041#> { ?s ?p ?o } }",
        "SELECT * { SERVICE <URL\\u0041'> { ?s ?p ?o } } #'",
        "SELECT * { SERVICE <URL\xa0#> { ?s ?p ?o } }",
        "SELECT * { SERVICE <URL\u2003'> { ?s ?p ?o } } #'",
        # A space of Unicode is a letter of a name, and a carriage return ends a comment.
        "PREFIX a: <URL> SELECT * { SERVICE a:x\u1680y { ?s ?p ?o } }",
        "SELECT * { # c\rSERVICE <URL> { ?s ?p ?o }\n}",
    ],
)
def test_queries_do_not_reach_the_network(server, query):
    url, requests = server
    with pytest.raises(UserError, match="SPARQL query"):
        sparql(household(), query.replace("URL", url))
    assert requests == []


@pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows has no fence")
def test_a_query_that_is_taken_for_a_harmless_one_opens_no_connection(
    server, monkeypatch
):
    url, requests = server
    monkeypatch.setattr("knowarm.knowledge.queries.sparql._REMOTE", re.compile("(?!)"))
    with pytest.raises(UserError, match="SPARQL query: Too many open files"):
        sparql(household(), f"SELECT * {{ SERVICE <{url}> {{ ?s ?p ?o }} }}")
    assert requests == []


@pytest.mark.parametrize(
    "query",
    [
        "SELECT ?service { ?service :service ?from . OPTIONAL { ?service :from ?x } }",
        "PREFIX from: <http://x/> SELECT * { from:service ?p 'FROM', \"SERVICE <x> {\" }",
        "SELECT * { ?s <http://x/service> ?o { ?s :to-service ?from } } # FROM <x>",
    ],
)
def test_names_and_strings_are_no_remote_data(query):
    assert sparql(household(), query).rows == ()


@pytest.mark.parametrize("text", ["service" * 600, "a" * 30_000, "base <" * 20_000])
def test_what_is_read_of_a_long_query_before_its_limits_takes_seconds(text):
    begin = time.process_time()
    with pytest.raises(UserError, match="SPARQL query"):
        sparql(household(), text)
    assert time.process_time() - begin < 5


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
    with pytest.raises(
        UserError, match=r"refers to another document, .file:.*only the given one"
    ):
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
