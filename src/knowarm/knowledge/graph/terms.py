"""Names of entities and relations: strings that stand for RDF terms, and their readable labels.

The form of a name tells which RDF term it stands for:

    mug                           a plain name; its IRI is <urn:knowarm:mug>
    http://example.org/kitchen    an IRI (a scheme, a colon and no space)
    _:b1                          a blank node
    "0.35"^^<http://...#decimal>  a literal, as N-Triples writes it
"""

import re
import unicodedata
from collections.abc import Container, Iterator, Mapping
from contextlib import suppress
from itertools import count
from typing import NamedTuple
from urllib.parse import quote, unquote

from pyoxigraph import BlankNode, Literal, NamedNode, RdfFormat, Triple, parse

from knowarm.errors import UserError

NAMESPACE = "urn:knowarm:"
"""Namespace of the IRIs of plain names."""

RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
RDFS = "http://www.w3.org/2000/01/rdf-schema#"
LABEL_RELATIONS = (
    RDFS + "label",
    "http://www.w3.org/2004/02/skos/core#prefLabel",
)
"""Relations whose literals are labels; labels are written with the first."""
RDF_TYPE = RDF + "type"
"""The relation that Turtle writes as ``a``; its label is "is a"."""

_IRI = re.compile(r'[A-Za-z][A-Za-z0-9+.-]*:[^\s<>"{}|\\^`\x00-\x20]+')
_QUOTED = re.compile(r"[\x00-\x7f]+|\W+")
_ASCII = bytes(range(128)).decode()
_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_SPACE = re.compile(r"[\s_\-]+")
_SENSE = re.compile(r"\.[a-z](\.\d+)?$")
"""Kind or sense behind a word, as in WordNet's mug.n.04."""
_YEAR = r"(?:1[5-9]|20)\d\d$"
_NUMBERS = (
    rf"(?!{_YEAR})\d+"
    # Digits and letters a to f
    r"|(?=(?:\D*\d){2})(?=\d*[a-fA-F])[\da-fA-F]{4,}"
    # Random letters in both cases and digits, but no word with a number behind it
    r"|(?=.*[a-z])(?=.*[A-Z])(?=.*\d)(?![A-Z]?[a-z]+\d+$)(?!\d+[a-z]+$)[\dA-Za-z]{6,12}"
    r"|[\da-f]{8}(?:-[\da-f]{4}){3}-[\da-f]{12}"
)
"""Numbers of individuals, no years: the ends of mug_0, mug_12ab and Mug_n8p9V6."""
_PARTED = re.compile(rf"<?([^|]*?[^\W_])>?[\s_.#-]*[\s_.#(\[-](?:{_NUMBERS})[)\]]?")
_JOINED = re.compile(r"(.*[^\W\d_])\d{1,3}")
_AT_PLACE = re.compile(r"([^|]*[^\W_])\|[|\w.+-]*\d[|\w.+-]*")
"""The name of an object and its place or number, as in AI2-THOR: Mug|-00.53|+01.15|+00.10."""
_CONCEPT = re.compile(r"^/(?:c/\w+|r)/([^/]+).*")
"""Name of ConceptNet: /c/en/mug/n, /r/UsedFor."""
_PLURALS = {"ies": "i", "ie": "i", "y": "i", "oes": "o", "oe": "o", "ss": "ss", "us": "us",
            "is": "is", "sses": "ss", "xes": "x", "ches": "ch", "shes": "sh", "s": ""}  # fmt: skip
"""Endings that one word has in singular or plural, and what stands for both; the longest counts."""
_LAST = frozenset(ending[-1] for ending in _PLURALS)
Term = NamedNode | BlankNode | Literal


class NumberedName(NamedTuple):
    """A word with a number, such as "mug_0"."""

    word: str
    is_parted: bool
    """Whether a sign parts the number from it, as in "mug_0" but not in "mug1"."""


def literal(
    text: str, *, language: str | None = None, datatype: str | None = None
) -> str:
    """Return the name of a literal, with an optional language tag or datatype IRI."""
    if datatype is None:
        return str(Literal(text, language=language))
    return str(Literal(text, datatype=NamedNode(datatype)))


def parse_literal(name: str) -> Literal | None:
    """Return the RDF literal that a name stands for; None for any other name."""
    if not name.startswith('"'):
        return None
    with suppress(SyntaxError):
        quads = list(parse(f"<x:x> <x:x> {name} .", format=RdfFormat.N_TRIPLES))
        if len(quads) == 1 and isinstance(quads[0].object, Literal):
            return quads[0].object
    return None


def is_iri(name: str) -> bool:
    """Return whether a name is an IRI, and no plain name."""
    return _IRI.fullmatch(name) is not None


def iri_of_name(name: str) -> str:
    """Return the IRI of a name; a name that is no valid IRI gets one in `NAMESPACE`."""
    return iri_term(name).value


def name_of_iri(iri: str) -> str:
    """Return the name of an IRI without brackets: the plain name for those in `NAMESPACE`.

    Other names, such as literals, are returned unchanged.
    """
    if not iri.startswith(NAMESPACE):
        return iri
    name = unquote(iri.removeprefix(NAMESPACE))
    if not name or name.startswith(('"', "_:")) or "\0" in name:
        return iri
    # Only the IRI that `iri_of_name` makes stands for the name, written with é or with %C3%A9.
    if quote(iri_of_name(name), safe=_ASCII) != quote(iri, safe=_ASCII):
        return iri
    return name


def triple_of_names(head: str, relation: str, tail: str) -> Triple:
    """Return a triple of names as RDF; a literal as head or relation becomes an IRI."""
    return Triple(node_term(head), iri_term(relation), object_term(tail))


def blank_names(taken: Container[str]) -> Iterator[str]:
    """Yield names of blank nodes that are not taken: _:unnamed0, _:unnamed1, ..."""
    for number in count():
        name = f"_:unnamed{number}"
        if name not in taken:
            yield name


def name_of_term(term: Term | Triple) -> str:
    """Return the name of an RDF term."""
    if isinstance(term, NamedNode):
        return name_of_iri(term.value)
    if isinstance(term, Triple):
        raise UserError(
            f"The triple {term} is used as a term (RDF-star), which a knowledge graph cannot "
            f"hold. State it as a plain triple."
        )
    return str(term)


def local_name(name: str) -> str:
    """Return the short form of a name: the last part of an IRI, the text of a literal."""
    if name.startswith('"'):
        term = parse_literal(name)
        if term is not None:
            return term.value
    if ":" in name and is_iri(name):
        whole = name.rstrip("#/:")
        last = whole[max(map(whole.rfind, "#/:")) + 1 :]
        return unquote(last) if "%" in last else last
    return name


_DENYING = frozenset(
    ["not", "never", "neg", "negated", "negation", "negative", "denied", "denies"]
)
"""Last parts of namespaces that deny what they hold; "no" is Norwegian."""


def is_denied_by_namespace(name: str) -> bool:
    """Return whether the namespace of a relation denies it, as in ``http://a.org/not/usedFor``."""
    space = name.removesuffix(local_name(name)).rstrip("#/:")
    return local_name(space).casefold() in _DENYING


def name_key(text: str) -> str:
    """Return what the spellings of a name share: the same for "Wine_Glasses" and "wineGlass.n.01".

    Case, separators, number and sense make no difference, but in a text without letters.
    """
    if not text.isascii():
        text = unicodedata.normalize("NFC", text)
    text = text.casefold()
    key = text
    if not text.isalnum():  # else nothing is to be left out
        if text.startswith("/"):
            text = _CONCEPT.sub(r"\1", text)
        key = text
        if "." in key:
            key = _SENSE.sub("", key)
        key = "".join(key.split()).replace("_", "").replace("-", "")  # fast
    if not key.isalpha() and not any(map(str.isalpha, key)):
        return text
    if key[-1] not in _LAST:
        return key
    for length in (4, 3, 2, 1):
        ending = key[-length:]
        if ending in _PLURALS and len(key) > max(length, 3):
            return key[:-length] + _PLURALS[ending]
    return key


def numbered(name: str) -> NumberedName | None:
    """Return the word of a name that ends with a number: mug of "mug_0", "mug.001" and "mug1".

    "mug_rack", "mug_2019", "mug.n.04" and "mug_500ml" do not.
    """
    if _SENSE.search(name):
        return None
    parted = _PARTED.fullmatch(name) or _AT_PLACE.fullmatch(name)
    match = parted or _JOINED.fullmatch(name)
    if match is None or not any(map(str.isalpha, match[1])):
        return None
    return NumberedName(match[1], parted is not None)


def letters_of(text: str) -> str:
    """Return a text without separators, in lower case: "wineglass" of "Wine_Glass"."""
    return "".join(text.split()).replace("_", "").replace("-", "").casefold()


def label_of(name: str, labels: Mapping[str, str]) -> str:
    """Return the label of an entity or relation in lower case, words separated by one space."""
    text = labels.get(name)
    if text is None and name == RDF_TYPE:
        text = "is a"
    elif text is None:
        text = _CAMEL.sub(" ", local_name(name))
    return _SPACE.sub(" ", text).strip().lower()


def object_term(name: str) -> Term:
    """Return the term of a name as the object of a triple."""
    return parse_literal(name) or node_term(name)


def node_term(name: str) -> NamedNode | BlankNode:
    """Return the term of a name as the subject of a triple; a literal becomes an IRI."""
    if name.startswith("_:") and ":" not in name[2:]:
        with suppress(ValueError):
            return BlankNode(name[2:])
    return iri_term(name)


def iri_term(name: str) -> NamedNode:
    """Return the term of a name as the predicate of a triple, always an IRI."""
    if is_iri(name):
        with suppress(ValueError):
            return NamedNode(name)
    return NamedNode(
        NAMESPACE + _QUOTED.sub(lambda match: quote(match[0], safe=""), name)
    )
