"""Axioms of RDFS and OWL 2, and the rules by which facts follow from them.

The rules are those of OWL 2 RL, without those that say nothing ("everything is a Thing") and
without equality of what shares a value of a functional property: names of a graph are different
things. What a restriction states of all members of a class is a fact about the class:
`mug subClassOf (usedFor some Drinking)` is mug usedFor Drinking. Such a fact also holds of what is
below the class, and it says nothing about *all* drinking, so that neither an inverse nor a range
follows from it. It is therefore held under a relation of its own, the ``general`` one of usedFor.
"""

from knowarm.knowledge.graph.denials import denial
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.rules import read_rules
from knowarm.knowledge.graph.terms import RDF, RDFS

OWL = "http://www.w3.org/2002/07/owl#"
FRESH = "\0"
"""Begin of names that no graph can hold."""
NAMESPACES = {
    RDF: "type first rest",
    RDFS: "subClassOf subPropertyOf domain range",
    OWL: "equivalentClass equivalentProperty inverseOf sameAs differentFrom onProperty onClass "
    "onDataRange someValuesFrom allValuesFrom hasValue hasSelf cardinality minCardinality "
    "maxCardinality qualifiedCardinality minQualifiedCardinality maxQualifiedCardinality "
    "intersectionOf unionOf oneOf complementOf disjointWith disjointUnionOf members hasKey "
    "propertyDisjointWith propertyChainAxiom sourceIndividual assertionProperty "
    "targetIndividual targetValue SymmetricProperty TransitiveProperty FunctionalProperty "
    "InverseFunctionalProperty AllDisjointClasses AllDisjointProperties Class Thing Nothing",
    FRESH: "transitive target general denied generallyDenied kind left right result excludes "
    "neededBy",
}
"""Words of the rules by namespace."""


def _words() -> dict[str, str]:
    names = {}
    for namespace, words in NAMESPACES.items():
        for word in words.split():
            names[word] = namespace + word
    return names


WORDS = _words()
"""Names of the words."""
IS_A = (WORDS["type"], WORDS["subClassOf"])
"""What puts individuals and classes into classes."""
NOT_A = (denial(IS_A[0]), denial(IS_A[1]))
"""What denies it."""
WORDS["notType"] = NOT_A[0]
WORDS["notSubClassOf"] = NOT_A[1]

HIERARCHY = read_rules("""
    [?c subClassOf ?d], ?x type ?c -> ?x type ?d
    [?c subClassOf ?d], ?x subClassOf ?c -> ?x subClassOf ?d
    ?c equivalentClass ?d -> ?c subClassOf ?d
    ?c equivalentClass ?d -> ?d subClassOf ?c
""")
"""What follows from named classes alone; found first, it is the reason that is given."""

FACTS = HIERARCHY + read_rules("""
    ?p equivalentProperty ?q -> ?p subPropertyOf ?q
    ?p equivalentProperty ?q -> ?q subPropertyOf ?p
    ?p subPropertyOf ?q, ?x ?p ?y -> ?x ?q ?y
    ?p domain ?c, ?x ?p ?y -> ?x type ?c
    ?p range ?c, ?x ?p ?y -> ?y type ?c
    ?p inverseOf ?q, ?x ?p ?y -> ?y ?q ?x
    ?p inverseOf ?q, ?x ?q ?y -> ?y ?p ?x
    ?p type SymmetricProperty, ?x ?p ?y -> ?y ?p ?x
    ?r transitive ?s, ?x ?r ?y, [?y ?s ?z] -> ?x ?r ?z
    ?b result ?r, ?p ?b ?q, ?x ?p ?y, ?y ?q ?z -> ?x ?r ?z
    ?x sameAs ?y -> ?y sameAs ?x
    ?x sameAs ?y, ?y sameAs ?z -> ?x sameAs ?z
    ?x sameAs ?y, ?x ?p ?z -> ?y ?p ?z
    ?x sameAs ?y, ?z ?p ?x -> ?z ?p ?y
    ?p sameAs ?q, ?x ?p ?y -> ?x ?q ?y
    ?i left ?a, ?i right ?b, ?x type ?a, ?x type ?b -> ?x type ?i
    ?i left ?a, ?i right ?b, ?x subClassOf ?a, ?x subClassOf ?b -> ?x subClassOf ?i
    ?r someValuesFrom ?c, ?r onProperty ?p, ?x ?p ?y, ?y type ?c -> ?x type ?r
    ?r hasValue ?y, ?r onProperty ?p, ?x ?p ?y -> ?x type ?r
    ?r hasValue ?y, ?r onProperty ?p, ?x type ?r -> ?x ?p ?y
    ?r allValuesFrom ?c, ?r onProperty ?p, ?x type ?r, ?x ?p ?y -> ?y type ?c
    ?p general ?g, ?c ?g ?y, ?x type ?c -> ?x ?g ?y
    ?p general ?g, ?c ?g ?y, ?x subClassOf ?c -> ?x ?g ?y
    ?p general ?g, ?q general ?h, ?p subPropertyOf ?q -> ?g subPropertyOf ?h
    ?p general ?g, ?p domain ?c, ?x ?g ?y, ?x kind ?k -> ?x ?k ?c
    ?g neededBy ?b, ?y ?b ?r, ?x ?g ?y, ?x kind ?k -> ?x ?k ?r
    ?g neededBy ?b, ?c ?b ?r, ?y subClassOf ?c -> ?y ?b ?r
    ?g neededBy ?b, ?c ?b ?r, ?y type ?c -> ?y ?b ?r
""")
"""All that holds. ``?p ?b ?q`` chains relations; ``?y ?b ?r``: what has ``?g ?y`` is an ``?r``."""

DENIALS = read_rules("""
    ?e targetIndividual ?y -> ?e target ?y
    ?e targetValue ?y -> ?e target ?y
    ?p denied ?n, ?e assertionProperty ?p, ?e sourceIndividual ?x, ?e target ?y -> ?x ?n ?y
    ?q subPropertyOf ?p, ?p denied ?m, ?q denied ?n, ?x ?m ?y -> ?x ?n ?y
    ?p inverseOf ?q, ?p denied ?m, ?q denied ?n, ?x ?m ?y -> ?y ?n ?x
    ?p inverseOf ?q, ?p denied ?m, ?q denied ?n, ?x ?n ?y -> ?y ?m ?x
    ?p propertyDisjointWith ?q, ?q denied ?n, ?x ?p ?y -> ?x ?n ?y
    ?p propertyDisjointWith ?q, ?p denied ?n, ?x ?q ?y -> ?x ?n ?y
    ?p generallyDenied ?m, ?c ?m ?y, ?x type ?c -> ?x ?m ?y
    ?p generallyDenied ?m, ?c ?m ?y, ?x subClassOf ?c -> ?x ?m ?y
    ?p generallyDenied ?m, ?x ?m ?c, ?y type ?c -> ?x ?m ?y
    ?p generallyDenied ?m, ?x ?m ?c, ?y subClassOf ?c -> ?x ?m ?y
    ?q subPropertyOf ?p, ?p generallyDenied ?m, ?q generallyDenied ?n, ?x ?m ?y -> ?x ?n ?y
    ?c excludes ?d, ?x type ?c -> ?x notType ?d
    ?c excludes ?d, ?x subClassOf ?c -> ?x notSubClassOf ?d
""")
"""What does not hold."""

DENIALS_BELOW = read_rules("""
    ?e subClassOf ?d, ?x notType ?d -> ?x notType ?e
    ?e subClassOf ?d, ?x notSubClassOf ?d -> ?x notSubClassOf ?e
    ?e subClassOf ?d, ?x excludes ?d -> ?x notSubClassOf ?e
""")
"""What is no food is no apple."""

_AXIOMS = (
    "subClassOf subPropertyOf domain range equivalentClass equivalentProperty inverseOf sameAs "
    "onProperty intersectionOf unionOf oneOf complementOf disjointWith disjointUnionOf members "
    "propertyDisjointWith propertyChainAxiom assertionProperty"
)
_AXIOM_CLASSES = "SymmetricProperty TransitiveProperty"


def has_axioms(graph: KnowledgeGraph) -> bool:
    """Return whether a graph states anything from which facts follow."""
    relations = map(WORDS.__getitem__, _AXIOMS.split())
    classes = map(WORDS.__getitem__, _AXIOM_CLASSES.split())
    terms = graph.relation_names.find_all(relations) + graph.names.find_all(classes)
    return bool(terms)
