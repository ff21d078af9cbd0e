"""Graphs in one document: JSON, GraphML, GEXF and GML."""

import json
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from knowarm.errors import UserError
from knowarm.knowledge.formats.columns import columns_of, listed
from knowarm.knowledge.formats.files import open_bytes, python
from knowarm.knowledge.formats.json_forms import LINKS, PROGRAMS, Form
from knowarm.knowledge.formats.records import Records
from knowarm.knowledge.formats.scenes import SCENES
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.reading import reading

_BETWEEN = re.compile(r"[\s,;]*")
"""What may stand between the values of lines."""


def read_json_graph(path: Path) -> KnowledgeGraph:
    """Read lists of three, or objects with keys for head, relation and tail (see `ROLES`).

    They are the whole document, or lie beside ``nodes`` under one of the keys "links", "edges", ...
    as NetworkX and D3 write them; a link may give the number of a node, or the node itself. Or the
    document has one of the forms of scenes and other programs, or holds one object that has.
    """
    document = _json_value(path)
    parts = {"": document}
    if _form_of(document) is None and isinstance(document, dict):
        parts = {key: part for key, part in document.items() if _form_of(part)}
    if len(parts) > 1:
        raise UserError(
            f"{path} holds {len(parts)} graphs: {listed(parts)}. Save one of them as a file."
        )
    for part in parts.values():
        document = part
    form = _form_of(document)
    if form is None:
        _refuse_no_graph(document, path)
        form = LINKS
    remedy = f"It was read as {form.name}. Correct the file, or export it again."
    with reading(path, remedy):
        records = form.collects(path, form.name)
        form.read(document, records)
        return records.build()


def _json_value(path: Path) -> Any:
    """Return the value of a file, or the list of its values, of which it holds one per line."""
    decoder = json.JSONDecoder()
    values: list[Any] = []
    with reading(path, "Correct the file."), open_bytes(path) as file:
        text = file.read().decode()
        position = _behind_blanks(text, 0)
        while position < len(text):
            try:
                value, end = decoder.raw_decode(text, position)
            except json.JSONDecodeError as error:
                line = text.count("\n", 0, position) + 1 if values else error.lineno
                raise UserError(
                    f"{path}, line {line}: not well-formed JSON: {error.msg}. Correct the "
                    "line; a file holds one value, or one per line."
                ) from error
            values.append(value)
            position = _behind_blanks(text, end)
    if len(values) == 1:
        return values[0]
    return values


def _behind_blanks(text: str, position: int) -> int:
    return _BETWEEN.match(text, position).end()  # type: ignore[union-attr]


def _form_of(document: Any) -> Form | None:
    """Return the first of the forms that a document has."""
    forms = (form for form in (*SCENES, *PROGRAMS) if form.recognizes(document))
    return next(forms, None)


def _refuse_no_graph(document: Any, path: Path) -> None:
    """Refuse what is neither a list of links nor one link."""
    if isinstance(document, list):
        return
    if isinstance(document, dict):
        if not {dict, list}.intersection(map(type, document.values())):
            if columns_of(tuple(document), str(path)) is not None:
                return
        elif len(document) > 1:
            _refuse_by_name(document, path)
    raise UserError(
        f"{path}: this JSON is neither JSON-LD nor a graph. A graph is a list of "
        '["mug", "usedFor", "drinking"], of objects with the keys head, relation and tail, or '
        'an object with such a list under "links".'
    )


def _refuse_by_name(document: Mapping[str, Any], path: Path) -> None:
    """Refuse properties by name, {"mug": {"on": "desk"}, ...}, with a command that lists them."""
    kinds: set[type] = set()
    for properties in document.values():
        if isinstance(properties, dict):
            kinds.update(map(type, properties.values()))
        elif not isinstance(properties, list) or {*map(type, properties)} != {str}:
            return
    triples = '[[h, "hasProperty", t] for h in d for t in d[h]]'
    if kinds & {str, int, float, bool, list}:
        triples = (
            "[[h, r, t] for h in d for r in d[h] "
            "for t in (d[h][r] if isinstance(d[h][r], list) else [d[h][r]]) if t is not None]"
        )
    code = (
        "import json; d = json.load(open(<file>)); "
        f'json.dump({triples}, open(<made>, "w"))'
    )
    raise UserError(
        f"{path}: this JSON is neither JSON-LD nor a graph. If its keys are things, write triples: "
        f"{python(code, path, 'triples.json')}"
    )


def read_with_networkx(path: Path, kind: str) -> KnowledgeGraph:
    """Read "graphml", "gexf" or "gml", whose edges have a relation such as the value "label"."""
    import networkx  # takes time to import

    with (
        reading(path, "Correct the file, or export it again."),
        open_bytes(path) as file,
        warnings.catch_warnings(),
    ):
        # Values without a type are read as text
        warnings.simplefilter("ignore", UserWarning)
        options = {"label": "id"} if kind == "gml" else {}
        network = getattr(networkx, f"read_{kind}")(file, **options)
    if not network.is_directed():
        raise UserError(
            f"{path}: edges without a direction are no triples. Declare the edges as directed, if "
            "they lead from source to target."
        )
    records = Records(path)
    for name, values in network.nodes(data=True):
        records.add_node(name, values)
    for head, tail, values in network.edges(data=True):
        records.add_link({**values, "head": head, "tail": tail})
    return records.build()
