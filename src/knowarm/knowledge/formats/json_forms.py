"""JSON of graphs and of other programs: links, Neo4j, ConceptNet's API, HexTuples, SPARQL, ..."""

from collections.abc import Callable
from operator import itemgetter
from typing import Any, NamedTuple

from knowarm.errors import UserError
from knowarm.knowledge.formats.columns import columns_of
from knowarm.knowledge.formats.records import Records
from knowarm.knowledge.graph.terms import RDF_TYPE, RDFS, literal

_LISTS = ("links", "edges", "relationships", "triples", "facts")
"""Keys of an object under which links may lie."""
_MIN_WEIGHT = 1.0
"""Least weight of the edges of ConceptNet, as of its file of assertions."""
_ENGLISH = "/c/en/"
_LOOKED_AT = 100
"""Records among which one is looked for that is recognized."""


class Form(NamedTuple):
    """A kind of documents."""

    name: str
    read: Callable[[Any, Any], None]
    fits: Callable[[Any], bool]
    """Whether it is recognized by an object or list of the document."""
    under: tuple[str, ...] = ()
    """Key under which that lies; () where it is the document, or lies in it."""
    collects: type[Records] = Records

    def recognizes(self, document: Any) -> bool:
        """Return whether a document is of this kind."""
        places = _under(document, self.under)
        records = records_of(document, *self.under)
        return any(map(self.fits, [*places, *records[:_LOOKED_AT]]))


def has(*keys: str) -> Callable[[Any], bool]:
    """Return the function that tells whether a value is an object with some keys."""
    return lambda value: isinstance(value, dict) and value.keys() >= set(keys)


def records_of(document: Any, *keys: str) -> list[Any]:
    """Return the records under some keys of a document, or of itself without keys.

    They lie in a list, or in an object with one of them per key.
    """
    records = []
    for values in _under(document, keys):
        if isinstance(values, list):
            records += values
        elif isinstance(values, dict):
            records += filter(has(), values.values())
    return records


def _under(document: Any, keys: tuple[str, ...]) -> list[Any]:
    """Return what a document holds under keys, or itself without keys."""
    if not keys:
        return [document]
    if not isinstance(document, dict):
        return []
    return [document[key] for key in keys if key in document]


def _read_links(document: Any, records: Records) -> None:
    """Read a list of links, one link, or an object that holds a list beside nodes."""
    nodes: Any = []
    links = document
    if isinstance(document, dict):
        nodes = document.get("nodes", [])
        links = next(filter(_is_list, _under(document, _LISTS)), [document])
    elif list(map(type, document)) == [str, str, str]:
        links = [document]
    if isinstance(nodes, dict):  # as in the JSON Graph Format
        nodes = [{**about, "id": key} for key, about in nodes.items()]
    for number, node in enumerate(nodes):
        if isinstance(node, dict):
            records.add_node(node.get("id", number), node)
        else:
            records.add_node(node, {})
    # Links may count the nodes.
    if not any(isinstance(key, int) for key in records.names):
        records.names.update(enumerate(list(records.names.values())))
    for link in links:
        records.add_link(link)


def _is_list(value: Any) -> bool:
    return isinstance(value, list)


def _read_cytoscape(document: Any, records: Records) -> None:
    graph = {}
    for key in ("nodes", "edges"):
        inside = document["elements"].get(key, ())
        graph[key] = [record.get("data", {}) for record in inside]
    _read_links(graph, records)


def _is_neo4j(value: Any) -> bool:
    """Return whether a value is a record of an export of Neo4j by APOC."""
    return has("id", "type")(value) and value["type"] in ("node", "relationship")


def _read_neo4j(document: Any, records: Records) -> None:
    """Read nodes with their names and types, and relationships, from lines, lists or objects."""
    if isinstance(document, dict):
        document = [*document.get("nodes", []), *document.get("rels", [document])]
    for record in document:
        nodes = [record]
        if "start" in record:
            nodes = [record["start"], record["end"]]
            head, tail = map(itemgetter("id"), nodes)
            records.add_link([head, record.get("label"), tail])
            records.unread.update(record.get("properties") or ())
        for node in nodes:
            properties = node.get("properties") or {}
            records.unread.update(properties.keys() - {"name"})
            records.add_node(node["id"], {"name": properties.get("name")})
            for kind in node.get("labels") or ():
                records.add_link([node["id"], RDF_TYPE, kind])


def _read_conceptnet(document: Any, records: Records) -> None:
    """Read the English edges of an answer of the API that have the least weight or more."""
    for edge in document["edges"]:
        head = _identifier(edge["start"])
        relation = _identifier(edge["rel"])
        tail = _identifier(edge["end"])
        if float(edge.get("weight", _MIN_WEIGHT)) < _MIN_WEIGHT:
            records.left_out[f"edges of a weight below {_MIN_WEIGHT:g}"] += 1
        elif not (head.startswith(_ENGLISH) and tail.startswith(_ENGLISH)):
            records.left_out["edges with a term that is not English"] += 1
        else:
            name = relation.removeprefix("/r/")
            records.add_link([head.split("/")[3], name, tail.split("/")[3]])
    following = (document.get("view") or {}).get("nextPage")
    if following:
        records.left_out[f"next page, {following}"] += 1


def _identifier(term: Any) -> str:
    """Return the identifier of a term, which is an object or the identifier itself."""
    if isinstance(term, dict):
        return str(term.get("@id", ""))
    return str(term)


def _is_hextuple(value: Any) -> bool:
    return _is_list(value) and len(value) == 6 and isinstance(value[0], str)


def _read_hextuples(document: Any, records: Records) -> None:
    """Read triples of IRIs and literals; graphs are merged."""
    if _is_hextuple(document):
        document = [document]
    for head, relation, text, datatype, language, _ in document:
        tail = text
        if datatype.rpartition("/")[2] not in ("globalId", "localId"):
            tail = _literal(text, language, datatype)
        records.add_link([head, relation, tail])


def _literal(text: str, language: str, datatype: str) -> str:
    if language:
        return literal(text, language=language)
    return literal(text, datatype=datatype or None)


def _read_sparql(document: Any, records: Records) -> None:
    """Read the rows of an answer whose variables are named as head, relation and tail."""
    variables = document["head"].get("vars", [])
    try:
        columns = columns_of(tuple(variables), records.where)
    except UserError:
        columns = None
    if columns is None or len(variables) != 3:
        names = ", ".join(map("?{}".format, variables)) or "none"
        raise UserError(
            f"{records.where}: holds the answers of a SPARQL query, with the variables {names}. "
            "Ask for triples: SELECT ?s ?p ?o WHERE { ?s ?p ?o }, or CONSTRUCT, and save its "
            "answer as Turtle."
        )
    for row in document["results"]["bindings"]:
        records.add_link({name: _term(row.get(name)) for name in variables})


def _term(term: Any) -> str:
    """Return the name of a term; "" of an unbound variable."""
    if term is None:
        return ""
    text = term["value"]
    if term["type"] == "uri":
        return text
    if term["type"] == "bnode":
        return f"_:{text.removeprefix('_:')}"
    language = term.get("xml:lang", term.get("lang", ""))
    return _literal(text, language, term.get("datatype", ""))


def _is_rdf_json(value: Any) -> bool:
    """Return whether a value holds what RDF/JSON says about a subject: lists of terms."""
    is_term = has("type", "value")
    if not isinstance(value, dict) or not all(map(_is_list, value.values())):
        return False
    return any(terms and is_term(terms[0]) for terms in value.values())


def _read_rdf_json(document: Any, records: Records) -> None:
    for head, about in document.items():
        for relation, terms in about.items():
            for term in terms:
                records.add_link([head, relation, _term(term)])


def _refuse_wikidata(document: Any, records: Records) -> None:
    raise UserError(
        f"{records.where}: holds entities of Wikidata as JSON. Download them as Turtle: "
        "https://www.wikidata.org/wiki/Special:EntityData/Q81707.ttl, or ask "
        "https://query.wikidata.org for triples with CONSTRUCT."
    )


def _read_obographs(document: Any, records: Records) -> None:
    """Read the edges and labels of all graphs of an ontology."""
    for graph in document["graphs"]:
        others = graph.keys() - {"id", "lbl", "meta", "nodes", "edges"}
        records.unread.update(filter(graph.get, others))
        for node in graph.get("nodes", ()):
            records.add_node(node["id"], {})
            if node.get("lbl"):
                # As statements: terms of one label are no individuals of it.
                records.add_label(node["id"], node["lbl"])
            records.unread.update({"meta"} & node.keys())
        for edge in graph.get("edges", ()):
            relation = edge["pred"]
            if relation == "is_a":
                relation = RDFS + "subClassOf"
            records.add_link([edge["sub"], relation, edge["obj"]])


LINKS = Form("a graph", _read_links, _is_list, _LISTS)
"""Nodes and links of no program in particular."""
PROGRAMS = (
    Form("Neo4j", _read_neo4j, has("rels")),
    Form("Neo4j", _read_neo4j, _is_neo4j),
    Form("ConceptNet", _read_conceptnet, has("start", "rel", "end"), ("edges",)),
    Form("HexTuples", _read_hextuples, _is_hextuple),
    Form("SPARQL", _read_sparql, has("vars"), ("head",)),
    Form("SPARQL", _read_sparql, has("head", "boolean")),
    Form("RDF/JSON", _read_rdf_json, _is_rdf_json),
    Form("Wikidata", _refuse_wikidata, has("id", "labels", "claims")),
    Form("Cytoscape", _read_cytoscape, has("edges"), ("elements",)),
    Form("OBO Graphs", _read_obographs, has("graphs")),
    LINKS,
)
"""Forms of other programs, the plain one last."""
