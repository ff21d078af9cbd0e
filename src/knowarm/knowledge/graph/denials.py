"""Denials: relations whose names negate, such as notUsedFor, doesNotContain and unsafeFor.

A triple of such a relation denies the fact of the relation without the negation.
"""

import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import (
    RDF,
    RDF_TYPE,
    RDFS,
    is_denied_by_namespace,
    label_of,
    local_name,
    name_key,
)
from knowarm.reading import read_toml

_ENGLISH = read_toml(Path(__file__).with_name("negation.toml"))
_NEGATIONS = frozenset[str](_ENGLISH["negations"])
_LACKING = frozenset[str](_ENGLISH["lacking"])
_OPPOSING = frozenset[str](_ENGLISH["opposing"])
_SILENT = frozenset[str](_ENGLISH["silent"])
_PREFIXED = re.compile("|".join(_ENGLISH["prefixed"]))
_SUFFIXED = re.compile(_ENGLISH["suffixed"])
_WORDS = re.compile(r"[^\W_]+|[!~¬]")
_HAS = (("has",), ("has", "a"))
"""What says no more than "has part", of which "lacks" speaks, too."""
_STANDARD = (RDF, RDFS, "http://www.w3.org/2002/07/owl#")


class Stance(NamedTuple):
    """What a relation speaks of, alike in all spellings, and whether it denies it."""

    subject: tuple[str, ...]
    denies: bool


def stance(name: str, label: str = "") -> Stance:
    """Return the stance of a relation by its name, or by its label where it has one."""
    named = _stance(label or label_of(name, {}))
    return named._replace(denies=named.denies or is_denied_by_namespace(name))


def negative_words(words: Sequence[str]) -> set[str]:
    """Return which words of a relation's name turn its sense: {"unsafe"} of unsafe, for."""
    negative = {*_NEGATIONS, *_LACKING, *_OPPOSING}.intersection(words)
    for word in words:
        if _affirmed(word) != word or _SUFFIXED.fullmatch(word):
            negative.add(word)
    return negative


def denial(relation: str) -> str:
    """Return the name of the relation that denies a relation: notUsedFor of usedFor.

    It has the namespace of the relation, but for the vocabularies of RDF and OWL, which are not
    extended.
    """
    if relation == RDF_TYPE:
        return "isNotA"
    local = local_name(relation)
    denying = f"not{local[:1].upper()}{local[1:]}"
    if relation == local or relation.startswith(_STANDARD):
        return denying
    return relation.removesuffix(local) + denying


def opposed(graph: KnowledgeGraph, relation: str) -> list[int]:
    """Return the ids of the relations of a graph that deny a relation, or that it denies.

    A name without words, such as ">=", and one of a negation alone have none.
    """
    wanted = stance(relation, graph.labels.get(relation, ""))
    ids = list[int]()
    if not wanted.subject:
        return ids
    for index, name in enumerate(graph.relation_names):
        subject, denies = stance(name, graph.labels.get(name, ""))
        if subject == wanted.subject and denies != wanted.denies:
            ids.append(index)
    return ids


def without_derived(graph: KnowledgeGraph) -> KnowledgeGraph:
    """Return a graph without the denials that were derived: all that a mug is not.

    They answer questions. In vectors and drawings they would outweigh what is stated.
    """
    if graph.derivations is None:
        return graph
    denying = []
    for index, name in enumerate(graph.relation_names):
        if stance(name, graph.labels.get(name, "")).denies:
            denying.append(index)
    is_denial = np.isin(graph.relations, denying)
    is_denial &= graph.derivations.is_derived(graph.triples)
    nodes = np.setdiff1d(graph.nodes, graph.tails[is_denial])
    return graph.rows(~is_denial, nodes)


@lru_cache(maxsize=100_000)
def _stance(label: str) -> Stance:
    subject: list[str] = []
    denies = False
    has_none = False
    text = re.sub(r"['’]|\bto be\b", "", label.casefold())
    for word in _WORDS.findall(text):
        if word in _NEGATIONS:
            denies = not denies
            has_none = word == "no" and not subject
        elif word in _LACKING:
            denies = not denies
            has_none = True
        elif word in _SILENT:
            has_none = False
        else:
            affirmed = _affirmed(word)
            denies ^= affirmed != word
            if has_none and affirmed not in ("has", "have"):
                subject.append("has")
            has_none = False
            if affirmed.endswith("ed"):
                affirmed = affirmed[:-1]  # "doNotUseFor" denies usedFor
            subject.append("has" if affirmed == "have" else name_key(affirmed))
    if has_none or tuple(subject) in _HAS:
        subject = ["has", "part"]
    return Stance(tuple(subject), denies)


def _affirmed(word: str) -> str:
    """Return a word without the syllable that negates it: "safe" of "unsafe"."""
    match = _PREFIXED.fullmatch(word)
    return match[match.lastindex or 0] if match else word
