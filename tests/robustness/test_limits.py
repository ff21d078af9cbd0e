"""Files and queries from others: no network, and limits on size, depth and time."""

import bz2
import gzip
import http.server
import io
import lzma
import subprocess
import sys
import threading
import zipfile

import pytest

from knowarm.errors import UserError
from knowarm.knowledge import household, read_graph
from knowarm.knowledge.sparql import sparql
from knowarm.world.attach import read_mjcf

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


ENDLESS = """
from knowarm.errors import UserError
from knowarm.knowledge import household
from knowarm.knowledge.sparql import sparql

try:
    sparql(household(), "SELECT (COUNT(*) AS ?n) { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i . ?j ?k ?l }",
           timeout_s=0.1)
except UserError as error:
    print(error)
"""


def test_a_query_that_takes_for_ever_ends_and_so_does_the_process():
    done = subprocess.run([sys.executable, "-c", ENDLESS], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "no answer after 0.1 s" in done.stdout


def test_deeply_nested_xml_is_refused(tmp_path):
    path = tmp_path / "a.rdf"
    path.write_text(RDF + "<a>" * 200_000 + "</a>" * 200_000 + "</rdf:RDF>")
    with pytest.raises(UserError, match="nested more than 200 deep"):
        read_graph(path)


@pytest.mark.parametrize(
    ("entity", "message"),
    [
        ("".join(f'<!ENTITY e{i + 1} "{f"&e{i};" * 10}">' for i in range(12)), "refers to others"),
        (f'<!ENTITY e12 "{"x" * 100_000}">', "longer than 1000 letters"),
        ('<!ENTITY e12 SYSTEM "file:///etc/hostname">', "lies in another document"),
    ],
)
def test_entities_of_entities_are_refused(tmp_path, entity, message):
    path = tmp_path / "a.rdf"
    path.write_text(
        f'<!DOCTYPE x [<!ENTITY e0 "y">{entity}]>{RDF}<rdf:Description rdf:about="http://a/">'
        "<b>&e12;</b></rdf:Description></rdf:RDF>"
    )
    with pytest.raises(UserError, match=message):
        read_graph(path)


def test_entities_for_namespaces_are_read(tmp_path):
    path = tmp_path / "a.owl"
    path.write_text(
        f'<!DOCTYPE x [<!ENTITY n "http://n/">]>{RDF}<rdf:Description rdf:about="&n;mug">'
        '<isA rdf:resource="&n;cup"/></rdf:Description></rdf:RDF>'
    )
    assert list(read_graph(path)) == [("http://n/mug", "http://x/isA", "http://n/cup")]


@pytest.mark.parametrize("text", ['<http://a> <http://b> """' + "x" * 2**23, "# comment\n" * 2**20])
def test_megabytes_without_a_statement_are_refused(tmp_path, text):
    path = tmp_path / "a.ttl"
    path.write_text(text)
    with pytest.raises(UserError, match="4 MiB in a row hold no complete statement"):
        read_graph(path)


def zipped(data):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.tsv", data)
    return file.getvalue()


@pytest.mark.parametrize(
    ("suffix", "compress"),
    [("gz", gzip.compress), ("bz2", bz2.compress), ("xz", lzma.compress), ("zip", zipped)],
)
def test_files_that_decompress_to_far_more_than_their_size_are_refused(
    tmp_path, monkeypatch, suffix, compress
):
    monkeypatch.setattr("knowarm.knowledge.formats.lines.MAX_SMALL", 2**20)
    path = tmp_path / f"a.tsv.{suffix}"
    path.write_bytes(compress(b"\n" * 2**21))
    with pytest.raises(UserError, match="250 times its compressed size"):
        read_graph(path)


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
    with pytest.raises(UserError, match="cannot be read or decompressed"):
        read_graph(path)


def test_ids_are_ascii_digits(tmp_path):
    for name, text in (("entity", "1\nmug\t²\n"), ("relation", "1\nisA\t0\n"), ("train", "0\n")):
        (tmp_path / f"{name}2id.txt").write_text(text, encoding="utf-8")
    with pytest.raises(UserError, match="expected `name<tab>id`"):
        read_graph(tmp_path)


@pytest.mark.parametrize(
    ("asset", "message"),
    [
        ('<texture name="t" type="2d" builtin="flat" width="50000" height="50000"/>', "texture"),
        ('<texture name="t" type="cube" builtin="flat" width="50000"/>', "texture"),
        ('<hfield name="h" nrow="50000" ncol="50000" size="1 1 1 1"/>', "height field"),
    ],
)
def test_mjcf_that_would_take_gigabytes_is_refused(tmp_path, asset, message):
    path = tmp_path / "a.xml"
    path.write_text(f"<mujoco><asset>{asset}</asset></mujoco>")
    with pytest.raises(UserError, match=message):
        read_mjcf(path, "Robot 'own'")


@pytest.mark.parametrize("included", [False, True])
def test_a_height_field_is_refused_before_mujoco_reserves_its_memory(
    tmp_path, monkeypatch, included
):
    path, other = tmp_path / "a.xml", tmp_path / "b.xml"
    field = "<hfield name='h'\n ncol = '50000' size='1 1 1 1' nrow='50000'/>"
    path.write_text(f"<mujoco><asset>{field}</asset></mujoco>")
    other.write_text('<mujoco><include file="a.xml"/></mujoco>')
    monkeypatch.setattr("mujoco.MjSpec", None)
    with pytest.raises(UserError, match="height field has 2,500,000,000"):
        read_mjcf(other if included else path, "Robot 'own'")


@pytest.mark.parametrize("included", [False, True])
def test_mjcf_with_millions_of_copies_is_refused(tmp_path, included):
    copies = '<body><geom size="1"/></body>'
    for _ in range(4):
        copies = f'<replicate count="1000" offset="1 0 0">{copies}</replicate>'
    path, other = tmp_path / "a.xml", tmp_path / "b.xml"
    path.write_text(f"<mujoco><worldbody>{copies}</worldbody></mujoco>")
    other.write_text('<mujoco><include file="a.xml"/></mujoco>')
    with pytest.raises(UserError, match="at most 10,000 copies"):
        read_mjcf(other if included else path, "Robot 'own'")
