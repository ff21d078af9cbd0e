"""Compare what follows in KnowArm with two independent reasoners, owlrl and reasonable.

python -m benchmarks.reasoners HomeRiskActivityOntology.ttl DUL.owl ...

needs `pip install owlrl reasonable`. Both get the stated triples; functional properties are left
out, from which KnowArm reads no equality. Compared are types, classes above, sameness and facts.

What restrictions state about classes is no rule of OWL 2 RL. It is compared in a second run, in
which every class has a typical member and every restriction a typical filler: `C subClassOf D` if
the member of C is a D, and `C p D` if it is p-related to a filler that is a D. Typical fillers
belong to all members at once; the reference may therefore say more, and never less.
"""

import argparse
import sys
import time
import warnings
from collections import defaultdict
from pathlib import Path

import rdflib
from rdflib import OWL, RDF, RDFS, BNode, Literal, URIRef

from knowarm.errors import DataWarning
from knowarm.knowledge import KnowledgeGraph, read_graph
from knowarm.knowledge.graph.denials import stance
from knowarm.knowledge.graph.owl import NAMESPACES
from knowarm.knowledge.graph.terms import iri_of_name, parse_literal

Triple = tuple[rdflib.term.Node, rdflib.term.Node, rdflib.term.Node]

VOCABULARIES = (*NAMESPACES, "http://www.w3.org/2001/XMLSchema#")
STRUCTURE = {
    OWL.onProperty, OWL.intersectionOf, OWL.unionOf, OWL.oneOf, OWL.complementOf, OWL.members,
    OWL.assertionProperty, RDF.first, RDF.rest,
}  # fmt: skip
FUNCTIONAL = {OWL.FunctionalProperty, OWL.InverseFunctionalProperty}
TYPICAL = "urn:typical:"


def node(name: str) -> rdflib.term.Node:
    """Return the RDF term of a name."""
    literal = parse_literal(name)
    if literal is None:
        return BNode(name[2:]) if name.startswith("_:") else URIRef(iri_of_name(name))
    if literal.language:
        return Literal(literal.value, lang=literal.language)
    return Literal(literal.value, datatype=URIRef(literal.datatype.value))


def terms(graph: KnowledgeGraph) -> set[Triple]:
    """Return the triples of a graph as RDF terms."""
    nodes = {name: node(name) for name in (*graph.names, *graph.relation_names)}
    return {
        (nodes[head], nodes[relation], nodes[tail]) for head, relation, tail in graph
    }


def closure(triples: set[Triple], reasoner: str) -> set[Triple]:
    """Return all triples that follow, by an independent reasoner."""
    graph = rdflib.Graph()
    for triple in triples:
        if triple[2] not in FUNCTIONAL:
            graph.add(triple)
    if reasoner == "owlrl":
        import owlrl  # type: ignore[import-not-found,unused-ignore]

        owlrl.DeductiveClosure(owlrl.OWLRL_Semantics).expand(graph)
        return set(graph)
    import reasonable  # type: ignore[import-not-found,unused-ignore]

    other = reasonable.PyReasoner()
    other.from_graph(graph)
    return set(other.reason())


def telling(triples: set[Triple], stated: set[Triple]) -> set[Triple]:
    """Return the triples that say something new about things and classes."""
    parts = {s for s, p, _ in stated if isinstance(s, BNode) and p in STRUCTURE}
    kept = set()
    for triple in triples - stated:
        head, relation, tail = triple
        ends = [end for end in (head, tail) if not isinstance(end, Literal)]
        is_known = str(relation).startswith(VOCABULARIES)
        if is_known and relation not in (RDF.type, RDFS.subClassOf, OWL.sameAs):
            continue
        if isinstance(head, Literal) or (is_known and head == tail):
            continue
        if any(end in parts or str(end).startswith(VOCABULARIES) for end in ends):
            continue
        kept.add(triple)
    return kept


def is_denial(triple: Triple) -> bool:
    """Return whether a triple says what does not hold."""
    return stance(str(triple[1])).denies


def with_typical(stated: set[Triple], classes: set[rdflib.term.Node]) -> set[Triple]:
    """Add a typical member of every class and a typical filler of every restriction."""
    more = set(stated)
    for name in classes:
        more.add((URIRef(f"{TYPICAL}member:{name}"), RDF.type, name))
    graph = rdflib.Graph()
    for triple in stated:
        graph.add(triple)
    for restriction, relation in graph.subject_objects(OWL.onProperty):
        fillers = list(graph.objects(restriction, OWL.someValuesFrom))
        for bound in (OWL.qualifiedCardinality, OWL.minQualifiedCardinality):
            if any(
                int(str(number)) > 0 for number in graph.objects(restriction, bound)
            ):
                fillers += graph.objects(restriction, OWL.onClass)
        for number, filler in enumerate(fillers):
            typical = URIRef(f"{TYPICAL}filler:{restriction}:{number}")
            same = BNode()
            more |= {
                (typical, RDF.type, filler),
                (restriction, RDFS.subClassOf, same),
                (same, OWL.onProperty, relation),
                (same, OWL.hasValue, typical),
                (same, RDF.type, OWL.Restriction),
            }
    return more


def of_typical(stated: set[Triple], reasoner: str) -> set[Triple]:
    """Return what holds of typical members, as triples about their classes."""
    classes = set[rdflib.term.Node]()
    for head, relation, tail in stated:
        if relation in (RDFS.subClassOf, OWL.equivalentClass):
            classes.update((head, tail))
        elif relation == RDF.type and tail == OWL.Class:
            classes.add(head)
    everything = closure(with_typical(stated, classes), reasoner)
    kinds = defaultdict[rdflib.term.Node, set[rdflib.term.Node]](set)
    for head, relation, tail in everything:
        if relation == RDF.type:
            kinds[head].add(tail)
    facts = set(everything)
    for head, relation, tail in everything:
        about = head
        if str(head).startswith(f"{TYPICAL}member:"):
            about = URIRef(str(head).removeprefix(f"{TYPICAL}member:"))
        for value in (tail, *kinds[tail]):
            facts.add((about, relation, value))
        if relation == RDF.type:
            facts.add((about, RDFS.subClassOf, tail))
    return facts


def compare(path: Path, reasoner: str) -> int:
    """Print the comparison of one file; return the number of differences."""
    start = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        graph = read_graph(path)
    seconds = time.process_time() - start
    stated = terms(graph.stated())
    start = time.process_time()
    theirs = telling(closure(stated, reasoner), stated)
    their_seconds = time.process_time() - start
    ours = {triple for triple in terms(graph) - stated if not is_denial(triple)}
    missing = theirs - ours
    about_classes = ours - theirs
    typical = of_typical(stated, reasoner)
    wrong = about_classes - typical
    classes = {triple for triple in typical if triple[1] == RDFS.subClassOf}
    known = {triple[0] for triple in stated if triple[1] == RDFS.subClassOf}
    further = {
        triple
        for triple in telling(classes, stated) - ours
        if triple[0] in known and not isinstance(triple[2], BNode)
    }
    print(
        f"{path.name}: {len(stated)} stated, both add {len(ours & theirs)}, only {reasoner} "
        f"{len(missing)}; about classes {len(about_classes)}, not of typical members "
        f"{len(wrong)}, classes of typical members alone {len(further)}; {seconds:.2f} s with "
        f"reading, {reasoner} {their_seconds:.2f} s"
    )
    for title, triples in (
        ("missing", missing),
        ("unexplained", wrong),
        ("further", further),
    ):
        for triple in sorted(triples)[:5]:
            print(f"  {title}:", *triple)
    return len(missing) + len(wrong)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--reasoner", choices=["owlrl", "reasonable"], default="owlrl")
    arguments = parser.parse_args()
    sys.exit(sum(compare(path, arguments.reasoner) for path in arguments.files) > 0)


if __name__ == "__main__":
    main()
