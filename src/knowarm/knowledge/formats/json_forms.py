"""JSON as other programs write it: lines of values, Neo4j, ConceptNet's API, HexTuples, SPARQL."""

import json
import re
import shlex
from collections.abc import Callable, Iterator, Mapping
from operator import itemgetter
from pathlib import Path
from typing import Any

from knowarm.errors import UserError, warn
from knowarm.knowledge.formats.columns import columns_of, listed
from knowarm.knowledge.formats.files import open_bytes
from knowarm.knowledge.graph.terms import LABEL_RELATIONS, RDF_TYPE, RDFS, literal
from knowarm.reading import reading

_BETWEEN = re.compile(r"[\s,;]*")
"""What may stand between the values of lines."""
_MIN_WEIGHT = 1.0
"""Least weight of the edges of ConceptNet, as of its file of assertions."""
_Graph = dict[str, Any]
"""Nodes and links, as the reader of JSON takes them."""


def json_value(path: Path) -> Any:
    """Return the value of a file, or the list of its values, of which it holds one per line."""
    with reading(path, "Correct the file."), open_bytes(path) as file:
        text = file.read().decode()
    values = list(_values(text, path))
    if len(values) == 1:
        return values[0]
    return values


def _values(text: str, path: Path) -> Iterator[Any]:
    """Yield the values that stand one after the other."""
    decoder = json.JSONDecoder()
    position = _BETWEEN.match(text).end()  # type: ignore[union-attr]
    while position < len(text):
        with reading(path, "Correct the file."):
            try:
                value, position = decoder.raw_decode(text, position)
            except json.JSONDecodeError as error:
                line = text.count("\n", 0, position) + 1 if position else error.lineno
                raise UserError(
                    f"{path}, line {line}: not well-formed JSON: {error.msg}. Correct the "
                    "line; a file holds one value, or one per line."
                ) from error
        yield value
        position = _BETWEEN.match(text, position).end()  # type: ignore[union-attr]


def plain_graph(value: Any, path: Path) -> Any:
    """Return nodes and links of a form of another program, other values as they are."""
    for is_form, graph_of_form in _FORMS:
        if is_form(value):
            return graph_of_form(value, path)
    return value


def _is_triple(value: Any) -> bool:
    """Return whether a value is a list of three texts."""
    return isinstance(value, list) and list(map(type, value)) == [str, str, str]


def _all_have(keys: set[str], records: Any) -> bool:
    """Return whether a value is a list of objects that have keys."""
    if not isinstance(records, list) or not records:
        return False
    for record in records:
        if not isinstance(record, dict) or not keys <= record.keys():
            return False
    return True


def _one_triple(value: list[str], path: Path) -> _Graph:
    """Return the graph of a file with one line."""
    return {"links": [value]}


def _is_link(value: Any) -> bool:
    """Return whether a value is an object with a head and a tail."""
    if not isinstance(value, dict):
        return False
    if {dict, list}.intersection(map(type, value.values())):
        return False
    try:
        return columns_of(list(value), Path()) is not None
    except UserError:
        return True  # The reader of links says what is wrong


def columns_of_keys(value: Mapping[str, Any]) -> Any:
    """Return the columns that keys name, None without."""
    try:
        return columns_of(list(value), Path())
    except UserError:
        return None


def _is_apoc(value: Any) -> bool:
    """Return whether a value is an export of Neo4j by APOC: lines, a list, or "nodes", "rels"."""
    if isinstance(value, dict) and "rels" in value:
        return True
    records = value if isinstance(value, list) else [value]
    if not _all_have({"type", "id"}, records):
        return False
    return {"node", "relationship"}.issuperset(map(itemgetter("type"), records))


def _apoc(value: Any, path: Path) -> _Graph:
    """Return nodes with their names and types, and relationships."""
    records = value if isinstance(value, list) else [value]
    if isinstance(value, dict) and "rels" in value:
        records = [*value.get("nodes", []), *value["rels"]]
    nodes = dict[Any, dict[str, Any]]()
    types = dict[tuple[Any, str], None]()
    links = list[Any]()
    properties = set[str]()
    for record in records:
        inside = record.get("properties") or {}
        if "start" not in record:
            _add_node(record, nodes, types)
            properties.update(inside.keys() - {"name"})
            continue
        for end in (record["start"], record["end"]):
            if end.get("id") not in nodes or end.get("properties"):
                _add_node(end, nodes, types)
        properties.update(inside)
        head = record["start"].get("id")
        links.append([head, record.get("label"), record["end"].get("id")])
    if properties:
        warn(f"{path}: these properties are not read: {listed(sorted(properties))}.")
    for node, kind in types:
        links.append([node, RDF_TYPE, kind])
    return {"nodes": list(nodes.values()), "links": links}


def _add_node(
    record: Mapping[str, Any],
    nodes: dict[Any, dict[str, Any]],
    types: dict[tuple[Any, str], None],
) -> None:
    key = record.get("id")
    node = {"id": key}
    name = (record.get("properties") or {}).get("name")
    if name is not None:
        node["name"] = name
    nodes[key] = nodes.get(key, {}) | node
    for kind in record.get("labels") or ():
        types[key, kind] = None


def _is_conceptnet(value: Any) -> bool:
    """Return whether a value is an answer of ConceptNet's API."""
    if not isinstance(value, dict):
        return False
    return _all_have({"start", "rel", "end"}, value.get("edges"))


def _conceptnet(value: Mapping[str, Any], path: Path) -> _Graph:
    """Return the English edges of a page that have the least weight or more."""
    links = list[Any]()
    weak = 0
    foreign = 0
    for edge in value["edges"]:
        language, head = _concept(edge["start"])
        other_language, tail = _concept(edge["end"])
        if float(edge.get("weight", _MIN_WEIGHT)) < _MIN_WEIGHT:
            weak += 1
        elif language != "en" or other_language != "en":
            foreign += 1
        else:
            relation = _identifier(edge["rel"]).removeprefix("/r/")
            links.append([head, relation, tail])
    left_out = []
    if weak:
        left_out.append(f"{weak} edges of a weight below {_MIN_WEIGHT:g}")
    if foreign:
        left_out.append(f"{foreign} edges with a term that is not English")
    following = (value.get("view") or {}).get("nextPage")
    if following:
        left_out.append(f"the edges of the next page, {following}")
    if left_out:
        warn(f"{path}: left out are {' and '.join(left_out)}.")
    return {"links": links}


def _identifier(term: Any) -> str:
    """Return the identifier of a term, which is an object or the identifier itself."""
    return str(term.get("@id", "")) if isinstance(term, dict) else str(term)


def _concept(term: Any) -> tuple[str, str]:
    """Return the language and the name of a term: of /c/en/mug/n."""
    cells = _identifier(term).split("/")
    if len(cells) < 4 or cells[1] != "c":
        return "", ""
    return cells[2], cells[3]


def _is_hextuples(value: Any) -> bool:
    """Return whether all values are lists of six strings, the fourth a datatype."""
    records = value
    if isinstance(value, list) and value and isinstance(value[0], str):
        records = [value]
    if not isinstance(records, list) or set(map(type, records)) != {list}:
        return False
    return set(map(len, records)) == {6}


def _hextuples(value: list[Any], path: Path) -> _Graph:
    """Return triples of IRIs and literals; graphs are merged."""
    records = [value] if value and isinstance(value[0], str) else value
    links = []
    for head, relation, text, datatype, language, _ in records:
        tail = text
        if datatype.rpartition("/")[2] not in ("globalId", "localId"):
            tail = _hex_literal(text, datatype, language)
        links.append([head, relation, tail])
    return {"links": links}


def _hex_literal(text: str, datatype: str, language: str) -> str:
    if language:
        return literal(text, language=language)
    if not datatype or datatype.endswith("#string"):
        return literal(text)
    return literal(text, datatype=datatype)


def _is_sparql(value: Any) -> bool:
    """Return whether a value is the answer to a SPARQL query."""
    if not isinstance(value, dict) or not isinstance(value.get("head"), dict):
        return False
    return "results" in value or "boolean" in value


def _sparql(value: Mapping[str, Any], path: Path) -> _Graph:
    """Return the rows of an answer whose variables are named as head, relation and tail."""
    variables = value["head"].get("vars", [])
    columns = columns_of_keys(dict.fromkeys(variables))
    if columns is None or len(variables) != 3:
        names = ", ".join(map("?{}".format, variables)) or "none"
        raise UserError(
            f"{path}: holds the answers of a SPARQL query, with the variables {names}. Ask for "
            "triples: SELECT ?s ?p ?o WHERE { ?s ?p ?o }, or CONSTRUCT, and save its answer as "
            "Turtle."
        )
    links = []
    for row in value["results"]["bindings"]:
        terms = map(row.get, map(variables.__getitem__, columns))
        links.append(list(map(_sparql_term, terms)))
    return {"links": links}


def _sparql_term(term: Mapping[str, str] | None) -> str:
    """Return the name of a term; "" of an unbound variable."""
    if term is None:
        return ""
    if term["type"] == "uri":
        return term["value"]
    if term["type"] == "bnode":
        return f"_:{term['value']}"
    return _hex_literal(
        term["value"], term.get("datatype", ""), term.get("xml:lang", "")
    )


def _is_rdf_json(value: Any) -> bool:
    """Return whether a value is RDF/JSON: terms by subject and predicate."""
    if not isinstance(value, dict) or not value:
        return False
    for about in value.values():
        if not isinstance(about, dict) or not about:
            return False
        for terms in about.values():
            if not _all_have({"type", "value"}, terms):
                return False
    return True


def _rdf_json(value: Mapping[str, Any], path: Path) -> _Graph:
    """Return the triples of RDF/JSON."""
    links = []
    for head, about in value.items():
        for relation, terms in about.items():
            for term in terms:
                plain = dict(term)
                plain["xml:lang"] = term.get("lang", "")
                links.append([head, relation, _sparql_term(plain)])
    return {"links": links}


def _is_wikidata(value: Any) -> bool:
    """Return whether a value holds entities of Wikidata's dump or API."""
    if isinstance(value, dict) and isinstance(value.get("entities"), dict):
        value = list(value["entities"].values())
    records = value if isinstance(value, list) else [value]
    return _all_have({"id", "labels", "claims"}, records)


def _refuse_wikidata(value: Any, path: Path) -> _Graph:
    raise UserError(
        f"{path}: holds entities of Wikidata as JSON. Download them as Turtle: "
        "https://www.wikidata.org/wiki/Special:EntityData/Q81707.ttl, or ask "
        "https://query.wikidata.org for triples with CONSTRUCT."
    )


def _is_by_name(value: Any) -> bool:
    """Return whether a value holds properties of things by name: {"mug": {"on": "desk"}, ...}."""
    if not isinstance(value, dict) or len(value) < 2:
        return False
    return all(map(_is_properties, value.values()))


def _is_properties(value: Any) -> bool:
    """Return whether a value is an object with values, or a list of words."""
    if isinstance(value, list):
        return set(map(type, value)) == {str}
    return isinstance(value, dict)


def _refuse_by_name(value: Mapping[str, Any], path: Path) -> _Graph:
    """Refuse properties by name, with the command that lists them as triples."""
    file = json.dumps(str(path), ensure_ascii=False)
    triples = '[[h, "hasProperty", t] for h in d for t in d[h]]'
    if any(map(_has_words, value.values())):
        triples = (
            "[[h, r, t] for h in d for r in d[h] "
            "for t in (d[h][r] if isinstance(d[h][r], list) else [d[h][r]]) if t is not None]"
        )
    code = (
        f"import json; d = json.load(open({file})); "
        f'json.dump({triples}, open("triples.json", "w"))'
    )
    raise UserError(
        f"{path}: this JSON is neither JSON-LD nor a graph. If its keys are things, write triples: "
        f"python -c {shlex.quote(code)}"
    )


def _has_words(properties: Any) -> bool:
    """Return whether an object holds values of relations, and no further objects."""
    if not isinstance(properties, dict):
        return False
    return any(
        isinstance(inside, str | int | float | list) for inside in properties.values()
    )


def _is_cytoscape(value: Any) -> bool:
    """Return whether a value is a graph of Cytoscape, whose nodes and edges each have data."""
    elements = value.get("elements") if isinstance(value, dict) else None
    return isinstance(elements, dict) and "edges" in elements


def _cytoscape(value: Mapping[str, Any], path: Path) -> _Graph:
    """Return the data of nodes and edges."""
    elements = value["elements"]
    nodes = [node.get("data", {}) for node in elements.get("nodes", ())]
    links = [edge.get("data", {}) for edge in elements["edges"]]
    return {"nodes": nodes, "links": links}


def _is_json_graph(value: Any) -> bool:
    """Return whether a value is in the JSON Graph Format: nodes by identifier, and edges."""
    graph = value.get("graph") if isinstance(value, dict) else None
    return isinstance(graph, dict) and isinstance(graph.get("edges"), list)


def _json_graph(value: Mapping[str, Any], path: Path) -> _Graph:
    """Return nodes and edges."""
    graph = value["graph"]
    nodes = graph.get("nodes", {})
    if isinstance(nodes, dict):
        nodes = [{**about, "id": key} for key, about in nodes.items()]
    return {"nodes": nodes, "links": graph["edges"]}


def _is_obographs(value: Any) -> bool:
    """Return whether a value is in the JSON of OBO Graphs."""
    return isinstance(value, dict) and isinstance(value.get("graphs"), list)


def _obographs(value: Mapping[str, Any], path: Path) -> _Graph:
    """Return the edges and labels of all graphs."""
    nodes = list[Any]()
    links = list[Any]()
    others = set[str]()
    for graph in value["graphs"]:
        others.update(
            key for key in graph if key.endswith(("Axioms", "NodesSets")) and graph[key]
        )
        for node in graph.get("nodes", ()):
            nodes.append(node["id"])
            if node.get("lbl"):
                # As statements: terms of one label are no individuals of it.
                links.append([node["id"], LABEL_RELATIONS[0], literal(node["lbl"])])
            if "meta" in node:
                others.add("meta")
        for edge in graph.get("edges", ()):
            relation = edge["pred"]
            if relation == "is_a":
                relation = RDFS + "subClassOf"
            links.append([edge["sub"], relation, edge["obj"]])
    if others:
        warn(f"{path}: these values are not read: {listed(sorted(others))}.")
    return {"nodes": nodes, "links": links}


_FORMS: tuple[
    tuple[Callable[[Any], bool], Callable[[Any, Path], _Graph]],
    ...,
] = (
    (_is_triple, _one_triple),
    (_is_link, lambda value, path: {"links": [value]}),
    (_is_apoc, _apoc),
    (_is_conceptnet, _conceptnet),
    (_is_hextuples, _hextuples),
    (_is_sparql, _sparql),
    (_is_rdf_json, _rdf_json),
    (_is_wikidata, _refuse_wikidata),
    (_is_cytoscape, _cytoscape),
    (_is_json_graph, _json_graph),
    (_is_obographs, _obographs),
    (_is_by_name, _refuse_by_name),
)
"""How each form is recognized, and read."""
