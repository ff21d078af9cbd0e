"""Imports of ontologies: files at hand that hold them. Nothing is fetched."""

import os
import re
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np

from knowarm.errors import UserError, warn
from knowarm.knowledge.formats.files import beginning_of, suffix_of
from knowarm.knowledge.graph.builder import merged
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import RDF, RDF_TYPE, RDFS, local_name
from knowarm.reading import reading

_OWL = "http://www.w3.org/2002/07/owl"
_IMPORTS = f"{_OWL}#imports"
_ONTOLOGY = f"{_OWL}#Ontology"
_KNOWN = {_OWL, RDF.rstrip("#"), RDFS.rstrip("#")}
"""Vocabularies that are built in."""
_CATALOG = "catalog-v001.xml"
"""File in which Protégé notes where imports lie."""
_SUFFIXES = (
    ".owl",
    ".ttl",
    ".rdf",
    ".xml",
    ".nt",
    ".n3",
    ".ofn",
    ".omn",
    ".owx",
    ".jsonld",
    ".obo",
)

_Reader = Callable[[Path], KnowledgeGraph]


def with_imports(graph: KnowledgeGraph, path: Path, read: _Reader) -> KnowledgeGraph:
    """Return a graph of a file with all that it imports, also by way of others.

    An import is at hand if the catalog in the folder of the importing file names a file for it, if
    a file there has its name or lies where a relative address points to, or if a file there
    declares it. Others are named in a warning and in ``graph.missing``.

    Raises:
        UserError: a file that is imported, or the catalog, cannot be read.
    """
    files = {path.resolve()}
    declared = _KNOWN | _ontologies(graph)
    waiting = [(name, path) for name in _imports(graph).values()]
    missing: dict[str, None] = {}
    for name, importing in waiting:
        if _plain(name) in declared:
            continue
        declared.add(_plain(name))
        file = _file_of(name, importing, read)
        if file is None:
            missing[name] = None
        elif file.resolve() not in files:
            files.add(file.resolve())
            imported = read(file)
            declared |= _ontologies(imported)
            waiting += [(other, file) for other in _imports(imported).values()]
            graph = merged(_without_import(graph, name), imported)
    if missing:
        graph = graph.lacking(tuple(missing))
        warn(
            f"{path}: imports {', '.join(missing)}, which is not at hand, so that not all is known "
            f"that holds. Put the file into the folder {path.parent}."
        )
    return graph


def _imports(graph: KnowledgeGraph) -> dict[int, str]:
    """Return the names of what a graph imports, by the row that says so."""
    names = {}
    relation = graph.relation_names.find(_IMPORTS)
    for row in np.flatnonzero(graph.relations == relation):
        name = graph.names[graph.tails[row]]
        names[int(row)] = local_name(name) if name.startswith('"') else name
    return names


def _without_import(graph: KnowledgeGraph, name: str) -> KnowledgeGraph:
    """Return a graph that holds what it imports, and so does not state the import."""
    rows = [row for row, other in _imports(graph).items() if other == name]
    others = np.delete(np.arange(len(graph)), rows)
    return graph.rows(others, nodes=graph.nodes)


def _ontologies(graph: KnowledgeGraph) -> set[str]:
    """Return the plain names of the ontologies that a graph declares itself to be."""
    is_type = graph.relations == graph.relation_names.find(RDF_TYPE)
    is_ontology = graph.tails == graph.names.find(_ONTOLOGY)
    declared = graph.names.at(graph.heads[is_type & is_ontology])
    return set(map(_plain, declared))


def _plain(name: str) -> str:
    return name.rstrip("#/")


def _file_of(name: str, importing: Path, read: _Reader) -> Path | None:
    """Return the file that holds an ontology; None if it is not at hand."""
    folder = importing.absolute().parent
    for file in (*_in_catalog(name, folder), *_by_name(name, folder)):
        if file.is_file():
            return file
    for file in sorted(folder.iterdir()):
        if file.resolve() != importing.resolve() and _declares(file, name, read):
            return file
    return None


def _in_catalog(name: str, folder: Path) -> Iterator[Path]:
    """Yield the file that the catalog of a folder names for an ontology."""
    catalog = folder / _CATALOG
    if not catalog.is_file():
        return
    with reading(catalog, "Correct or remove it."):
        root = ElementTree.fromstring(catalog.read_bytes())
    for entry in root.iter():
        target = unquote(entry.get("uri", ""))
        is_it = _plain(entry.get("name", "")) == _plain(name)
        if is_it and target and "://" not in target:
            yield folder / target.removeprefix("file:")


def _by_name(name: str, folder: Path) -> Iterator[Path]:
    """Yield the files of a folder with the name of an ontology."""
    address = urlsplit(_plain(name))
    file = Path(os.path.normpath(unquote(address.path)))
    if address.scheme == "file" and file.is_relative_to(folder):
        yield file
    if file.name:
        for suffix in ("", *_SUFFIXES):
            yield folder / (file.name + suffix)


def _declares(file: Path, name: str, read: _Reader) -> bool:
    """Return whether a file is an ontology of a name, by its base or its statements."""
    if not file.is_file() or suffix_of(file) not in _SUFFIXES:
        return False
    iri = re.escape(_plain(name)) + "[#/]?"
    base = rf"""xml:base\s*=\s*["']{iri}["']|\bbase\s+<{iri}>"""
    with suppress(UserError), warnings.catch_warnings(action="ignore"):
        beginning = beginning_of(file)
        if re.search(base, beginning, re.IGNORECASE):
            return True
        if re.search(iri, beginning):
            return _plain(name) in _ontologies(read(file))
    return False
