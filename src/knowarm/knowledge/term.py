"""RDF terms go in; the plain names of the graph come out, and back.

A name is one string. Its form says what it stands for:

    mug                           a plain name; as RDF it is <urn:knowarm:mug>
    http://example.org/kitchen    an IRI (anything with a scheme and no space)
    _:b1                          a blank node
    "0.35"^^<http://...#decimal>  a literal, as N-Triples writes it
"""

import re
from urllib.parse import quote, unquote

NAMESPACE = "urn:knowarm:"
"""The namespace whose IRIs are plain names in the graph."""

_IRI = re.compile(r'[A-Za-z][A-Za-z0-9+.-]*:[^\s<>"{}|\\^`\x00-\x20]+')
_LITERAL = re.compile(
    r'"((?:[^"\\\n\r]|\\.)*)"(?:@[A-Za-z]+(?:-[A-Za-z0-9]+)*|\^\^<[^\s<>"{}|\\^`]+>)?'
)
_BLANK = re.compile(r"_:[A-Za-z0-9_](?:[A-Za-z0-9_.\-·]*[A-Za-z0-9_\-·])?")
_ESCAPE = re.compile(r"\\(?:u([0-9A-Fa-f]{4})|U([0-9A-Fa-f]{8})|(.))")
_ESCAPED = {"t": "\t", "n": "\n", "r": "\r", "b": "\b", "f": "\f", '"': '"', "'": "'", "\\": "\\"}
_UNSAFE = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\r": "\\r", "\t": "\\t", "\0": "\\u0000"}


def is_literal(name: str) -> bool:
    """Whether the name is a literal."""
    return _LITERAL.fullmatch(name) is not None


def is_blank(name: str) -> bool:
    """Whether the name is a blank node."""
    return _BLANK.fullmatch(name) is not None


def name_of_iri(iri: str) -> str:
    """Return the name of an IRI given without brackets: plain inside our namespace."""
    if iri.startswith(NAMESPACE):
        name = unquote(iri[len(NAMESPACE) :])
        if name and iri_of_name(name) == iri:
            return name
    return iri


def iri_of_name(name: str) -> str:
    """Return the IRI of a name that is neither a literal nor a blank node."""
    return name if _IRI.fullmatch(name) else NAMESPACE + quote(name, safe="")


def literal(text: str, *, language: str | None = None, datatype: str | None = None) -> str:
    """Return the name of a literal."""
    body = '"' + "".join(_UNSAFE.get(letter, letter) for letter in text) + '"'
    if language:
        return f"{body}@{language.lower()}"
    return f"{body}^^<{datatype}>" if datatype else body


def literal_parts(name: str) -> tuple[str, str | None, str | None]:
    """Split a literal's name into text, language and datatype."""
    end = name.rindex('"')
    text, tail = unescape(name[1:end]), name[end + 1 :]
    if tail.startswith("@"):
        return text, tail[1:], None
    return text, None, tail[3:-1] if tail else None


def unescape(text: str) -> str:
    r"""Replace N-Triples' escapes (``\n``, ``\u00e9``, ...) by what they stand for."""
    if "\\" not in text:
        return text

    def letter(match: re.Match[str]) -> str:
        short, long, other = match.groups()
        return _ESCAPED.get(other, other) if other else chr(int(short or long, 16))

    return _ESCAPE.sub(letter, text)


def n3(name: str) -> str:
    """Return the name as N-Triples writes it."""
    if is_literal(name) or is_blank(name):
        return name
    return f"<{iri_of_name(name)}>"


def local_name(name: str) -> str:
    """Return the short form a reader knows: the last part of an IRI, the text of a literal."""
    if is_literal(name):
        return literal_parts(name)[0]
    if _IRI.fullmatch(name):
        return unquote(re.split(r"[#/:]", name.rstrip("#/:"))[-1])
    return name
