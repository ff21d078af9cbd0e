"""N-Triples go in, parsed line by line; a KnowledgeGraph comes out."""

import re
from pathlib import Path

from knowarm.errors import UserError
from knowarm.knowledge.builder import GraphBuilder
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.read.label_choice import LABEL_RELATIONS, LabelChoice
from knowarm.knowledge.read.lines import decode, line_blocks, open_bytes
from knowarm.knowledge.term import NAMESPACE, literal, name_of_iri, unescape

_PLAIN = r'[^\x00-\x20<>"{}|\\^`]*'
_IRI = rf"<({_PLAIN}(?:\\(?:u[0-9A-Fa-f]{{4}}|U[0-9A-Fa-f]{{8}}){_PLAIN})*)>"
_BLANK = r"(_:[A-Za-z0-9_](?:[\w.\-·]*[\w\-·])?)"
_LITERAL = (
    r'("(?:[^"\\\n\r]|\\["\\bfnrt\']|\\u[0-9A-Fa-f]{4}|\\U[0-9A-Fa-f]{8})*"'
    r'(?:@[A-Za-z]+(?:-[A-Za-z0-9]+)*|\^\^<[^\x00-\x20<>"{}|^`]*>)?)'
)
_TRIPLE = re.compile(
    rf"[ \t]*(?:{_IRI}|{_BLANK})[ \t]*{_IRI}[ \t]*(?:{_IRI}|{_BLANK}|{_LITERAL})"
    r"[ \t]*\.[ \t]*(?:#.*)?"
)
_SKIP = re.compile(r"[ \t]*(?:#.*)?")


def read_ntriples(path: Path) -> KnowledgeGraph:
    """Read N-Triples (.nt, also packed), some 200,000 triples a second of CPU time.

    Labels (rdfs:label, skos:prefLabel) become labels, as with the other RDF formats.

    Raises:
        UserError: a line is no triple; it is named.
    """
    builder, labels = GraphBuilder(), LabelChoice()
    match, add = _TRIPLE.fullmatch, builder.add
    iris: dict[str, str] = {}

    def iri(text: str) -> str:
        name = iris.get(text)
        if name is None:
            plain = unescape(text)
            name = iris[text] = name_of_iri(plain) if plain.startswith(NAMESPACE) else plain
        return name

    with open_bytes(path) as file:
        for first, lines in line_blocks(file, path):
            for number, raw in enumerate(lines, first):
                line = decode(raw, path, number)
                found = match(line)
                if found is None:
                    if _SKIP.fullmatch(line):
                        continue
                    raise _malformed(path, number, line)
                head_iri, head_blank, relation, tail_iri, tail_blank, text = found.groups()
                head = head_blank if head_iri is None else iri(head_iri)
                if text is not None:
                    tail = _canonical(text)
                    if relation in LABEL_RELATIONS and labels.take(head, relation, tail):
                        continue
                else:
                    tail = tail_blank if tail_iri is None else iri(tail_iri)
                add(head, iri(relation), tail)
    return builder.build(labels.chosen())


def _canonical(text: str) -> str:
    """Return a literal's one spelling: needless escapes undone, the language in lower case."""
    if "\\" not in text and not text.rpartition('"')[2].startswith("@"):
        return text
    body, _, tail = text.rpartition('"')
    language = tail[1:] if tail.startswith("@") else None
    datatype = tail[3:-1] if tail.startswith("^^") else None
    return literal(unescape(body[1:]), language=language, datatype=datatype)


def _malformed(path: Path, number: int, line: str) -> UserError:
    shown = line if len(line) <= 80 else line[:77] + "..."
    return UserError(
        f"{path}, line {number}: not an N-Triples line: {shown!r}. Expected "
        f'`<head> <relation> <tail> .` with IRIs in <>, literals in "" and a full stop; '
        f"Turtle (prefixes, several facts a statement) needs the suffix .ttl."
    )
