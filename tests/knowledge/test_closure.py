"""What follows from axioms, what each triple follows from, and what does not follow."""

import re

import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.knowledge import gamma, graph_of, household, read_graph
from knowarm.knowledge.config import KnowledgeConfig
from knowarm.knowledge.draw import draw_svg
from knowarm.knowledge.formats import SHIPPED, write_graph
from knowarm.knowledge.graph import closure
from knowarm.knowledge.graph.builder import difference, union
from knowarm.knowledge.graph.closure import closed
from knowarm.knowledge.graph.denials import without_derived
from knowarm.knowledge.graph.edits import edited
from knowarm.knowledge.graph.terms import RDF, RDF_TYPE
from knowarm.knowledge.slots import scene_sentences
from tests.knowledge.ontologies import DISHES, KITCHEN, derived, local, read, some
from tests.thorough import thorough

pytestmark = pytest.mark.usefixtures("unfenced")

SUBCLASS = "http://www.w3.org/2000/01/rdf-schema#subClassOf"
OWL = "http://www.w3.org/2002/07/owl#"


@pytest.mark.parametrize(
    ("axioms", "expected"),
    [
        (DISHES, {"Teapot subClassOf Dish"}),
        (":Cup owl:equivalentClass :Mug . :m a :Mug .",
         {"Cup subClassOf Mug", "Mug subClassOf Cup", "m type Cup"}),
        (":in rdfs:subPropertyOf :near . :a :in :b .", {"a near b"}),
        (":in owl:equivalentProperty :inside . :a :in :b . :c :inside :d .",
         {"a inside b", "c in d"}),
        (":cuts rdfs:domain :Tool . :knife :cuts :bread .", {"knife type Tool"}),
        (":cuts rdfs:range :Food . :knife :cuts :bread .", {"bread type Food"}),
        (":price rdfs:range xsd:integer . :mug :price 3 .", set()),
        (":in owl:inverseOf :holds . :a :in :b . :c :holds :d .", {"b holds a", "d in c"}),
        (":near a owl:SymmetricProperty . :a :near :b .", {"b near a"}),
        (":in a owl:TransitiveProperty . :a :in :b . :b :in :c . :c :in :d .",
         {"a in c", "a in d", "b in d"}),
        (":uncle owl:propertyChainAxiom ( :parent :brother ) . :a :parent :b . :b :brother :c .",
         {"a uncle c"}),
        (":far owl:propertyChainAxiom ( :to :to :to ) . :a :to :b . :b :to :c . :c :to :d .",
         {"a far d"}),
        (":a owl:sameAs :b . :a :in :c . :d :near :b .",
         {"b sameAs a", "b in c", "d near a"}),
        (f":Wet rdfs:subClassOf {some('has', ':water', 'hasValue')} . :s a :Wet . :t :has :water ."
         f":Damp owl:equivalentClass {some('has', ':water', 'hasValue')} .",
         {"Wet has water", "Damp has water", "s has water", "Wet subClassOf Damp", "s type Damp",
          "t type Damp"}),
        (f":Holder owl:equivalentClass {some('holds', ':Drink')} . :tea a :Tea ."
         ":Tea rdfs:subClassOf :Drink . :cup :holds :tea ."
         f":Pot rdfs:subClassOf {some('holds', ':Tea')} .",
         {"tea type Drink", "cup type Holder", "Holder holds Drink", "Pot holds Tea",
          "Pot subClassOf Holder", "cup holds Drink", "cup holds Tea", "Pot holds Drink"}),
        (f":Pot rdfs:subClassOf {some('holds', ':Soup', 'allValuesFrom')} . :p a :Pot ;"
         ":holds :s .", {"s type Soup"}),
        (":A owl:equivalentClass [ owl:intersectionOf ( :B :C :D ) ] . :x a :B, :C, :D . :y a :A ."
         ":E rdfs:subClassOf :B, :C, :D .",
         {"x type A", "y type B", "y type C", "y type D", "A subClassOf B", "A subClassOf C",
          "A subClassOf D", "E subClassOf A"}),
        (":A owl:unionOf ( :B :C ) . :x a :C .", {"B subClassOf A", "C subClassOf A", "x type A"}),
        (":Colour owl:oneOf ( :red :blue ) .", {"red type Colour", "blue type Colour"}),
        (f":Cup rdfs:subClassOf {some('usedFor', ':Drinking')} . :Mug rdfs:subClassOf :Cup ."
         ":m a :Mug . :usedFor rdfs:subPropertyOf :relatedTo ; owl:inverseOf :needs ;"
         "rdfs:domain :Tool ; rdfs:range :Activity .",
         {"Cup usedFor Drinking", "Mug usedFor Drinking", "m usedFor Drinking", "m type Cup",
          "Cup relatedTo Drinking", "Mug relatedTo Drinking", "m relatedTo Drinking",
          "Cup subClassOf Tool", "Mug subClassOf Tool", "m type Tool"}),
        (f":Lid rdfs:subClassOf {some('partOf', ':Pot')} ."
         f":Pot rdfs:subClassOf {some('partOf', ':Set')} . :partOf a owl:TransitiveProperty ."
         ":knob :partOf :pot . :pot a :Pot .",
         {"Lid partOf Pot", "Pot partOf Set", "Lid partOf Set", "pot partOf Set",
          "knob partOf Set", "knob partOf Pot"}),
        (":Mug a owl:Class . :Mug rdfs:subClassOf owl:Thing . :m a :Mug, owl:NamedIndividual .",
         set()),
        (":a :p :b . :p a owl:ObjectProperty .", set()),
        (":p a owl:FunctionalProperty . :a :p :b, :c .", set()),
    ],
    ids=lambda value: value.strip()[:40] if isinstance(value, str) else "",
)  # fmt: skip
def test_what_follows(tmp_path, axioms, expected):
    graph, messages = read(tmp_path, axioms)
    assert derived(graph) == expected
    added = [
        message for message in messages if f" {len(expected)} triples follow" in message
    ]
    assert len(added) == bool(expected)
    stated = graph.stated()
    assert set(stated) <= set(graph)
    assert derived(stated) == set()
    for triple in graph:
        is_derived = triple not in stated
        assert bool(graph.because(triple)) == is_derived
        assert set(graph.because(triple)) <= set(graph)
        assert set(graph.grounds(triple)) <= set(graph)


@pytest.mark.parametrize(
    ("axioms", "expected"),
    [
        ("[] a owl:NegativePropertyAssertion ; owl:sourceIndividual :mug ;"
         "owl:assertionProperty :usedFor ; owl:targetIndividual :eating .",
         {"mug notUsedFor eating"}),
        ("[] a owl:NegativePropertyAssertion ; owl:sourceIndividual :mug ;"
         "owl:assertionProperty :price ; owl:targetValue 3 .",
         {'mug notPrice integer>'}),
        ("[] owl:sourceIndividual :mug ; owl:assertionProperty :near ; owl:targetIndividual :pan ."
         ":in rdfs:subPropertyOf :near . :near owl:inverseOf :by .",
         {"mug notNear pan", "mug notIn pan", "pan notBy mug"}),
        (":Mug rdfs:subClassOf :Vessel . :Apple rdfs:subClassOf :Food . :m a :Mug ."
         ":Vessel owl:disjointWith :Food .",
         {"m type Vessel", "Vessel notSubClassOf Food", "Vessel notSubClassOf Apple",
          "Mug notSubClassOf Food", "Mug notSubClassOf Apple", "m isNotA Food", "m isNotA Apple",
          "Food notSubClassOf Vessel", "Food notSubClassOf Mug", "Apple notSubClassOf Vessel",
          "Apple notSubClassOf Mug"}),
        ("[] a owl:AllDisjointClasses ; owl:members ( :A :B :C ) . :x a :A .",
         {"A notSubClassOf B", "A notSubClassOf C", "B notSubClassOf A", "B notSubClassOf C",
          "C notSubClassOf A", "C notSubClassOf B", "x isNotA B", "x isNotA C"}),
        (":A owl:disjointUnionOf ( :B :C ) . :x a :B .",
         {"B subClassOf A", "C subClassOf A", "x type A", "B notSubClassOf C",
          "C notSubClassOf B", "x isNotA C"}),
        (":Mug rdfs:subClassOf [ owl:complementOf :Food ] . :m a :Mug ."
         ":Apple rdfs:subClassOf :Food .",
         {"Mug notSubClassOf Food", "Mug notSubClassOf Apple", "m isNotA Food", "m isNotA Apple",
          "Food notSubClassOf Mug", "Apple notSubClassOf Mug"}),
        (":Inedible owl:complementOf :Food . :x a :Inedible . :y a :Food .",
         {"Inedible notSubClassOf Food", "Food notSubClassOf Inedible", "x isNotA Food",
          "y isNotA Inedible"}),
        (f":Mug rdfs:subClassOf [ owl:complementOf {some('usedFor', ':Eating')} ] . :m a :Mug ."
         ":Dining rdfs:subClassOf :Eating . :eats rdfs:subPropertyOf :usedFor .",
         {"Mug notUsedFor Eating", "m notUsedFor Eating", "Mug notUsedFor Dining",
          "m notUsedFor Dining", "Mug notEats Eating", "m notEats Eating", "Mug notEats Dining",
          "m notEats Dining"}),
        (":Mug rdfs:subClassOf [ owl:onProperty :hasPart ; owl:onClass :Lid ;"
         "owl:maxQualifiedCardinality 0 ] .", {"Mug notHasPart Lid"}),
        (":in owl:propertyDisjointWith :on . :a :in :b . :c :on :d .",
         {"a notOn b", "c notIn d"}),
        ("[] a owl:AllDisjointProperties ; owl:members ( :in :on ) . :a :in :b .", {"a notOn b"}),
    ],
    ids=lambda value: value.strip()[:40] if isinstance(value, str) else "",
)  # fmt: skip
def test_what_is_denied(tmp_path, axioms, expected):
    graph, _ = read(tmp_path, axioms)
    assert derived(graph) == expected
    path = tmp_path / "again.ttl"
    write_graph(graph, path)
    assert read_graph(path) == graph


def test_cardinalities_from_one_on_state_facts(tmp_path):
    graph, (message,) = read(
        tmp_path,
        """
:Mug rdfs:subClassOf [ owl:onProperty :hasPart ; owl:onClass :Handle ;
    owl:qualifiedCardinality 1 ],
  [ owl:onProperty :holds ; owl:onClass [ owl:intersectionOf ( :Hot :Liquid ) ] ;
    owl:minQualifiedCardinality 2 ],
  [ owl:onProperty :hasPart ; owl:onClass :Cap ; owl:minQualifiedCardinality 0 ],
  [ owl:onProperty :hasPart ; owl:onClass :Foot ; owl:maxQualifiedCardinality 1 ],
  [ owl:onProperty :price ; owl:onDataRange :Number ; owl:qualifiedCardinality 1 ] .
""",
    )
    assert derived(graph) == {"Mug hasPart Handle", "Mug holds Hot", "Mug holds Liquid"}
    unread = "1 maxQualifiedCardinality, 1 minQualifiedCardinality, 1 onDataRange, "
    assert f"nothing is read: {unread}1 qualifiedCardinality." in message


@pytest.mark.parametrize(
    ("number", "is_enough"),
    [
        ("owl:minQualifiedCardinality 1", True),
        ("owl:minQualifiedCardinality 3", False),
        ("owl:qualifiedCardinality 1", False),
    ],
)
def test_one_value_fills_a_restriction_only_where_one_is_enough(
    tmp_path, number, is_enough
):
    several = f"[ owl:onProperty :owns ; owl:onClass :Cat ; {number} ]"
    graph, _ = read(
        tmp_path,
        f":Crazy owl:equivalentClass {several} ."
        f":Bob rdfs:subClassOf {some('owns', ':Cat')} . :bob :owns :tom . :tom a :Cat ."
        f":Sane rdfs:subClassOf [ owl:complementOf {several} ] .",
    )
    triples = derived(graph)
    assert "Crazy owns Cat" in triples
    assert ("Bob subClassOf Crazy" in triples) == is_enough
    assert ("Sane notOwns Cat" in triples) == is_enough


def test_what_restrictions_say_holds_below(tmp_path):
    graph, (message,) = read(tmp_path, KITCHEN)
    facts = set()
    for triple in derived(graph):
        if " subClassOf " not in triple and " type " not in triple:
            facts.add(triple)
    used = {f"{name} usedFor Drinking" for name in ("Mug", "TeaCup", "mug-1")}
    held = {f"{name} holds Liquid" for name in ("Mug", "TeaCup", "mug-1", "Vessel")}
    priced = {f"{name} price integer>" for name in ("Tool", "Spoon")}
    assert facts == used | held | priced | {"Spoon hasPart Bowl", "Spoon hasPart Rigid"}
    assert "follow from axioms (RDFS, OWL 2) and were added." in message


def test_axioms_that_state_nothing_are_counted(tmp_path):
    graph, (message,) = read(
        tmp_path,
        f"""
:Pot rdfs:subClassOf [ owl:onProperty [ owl:inverseOf :in ] ; owl:someValuesFrom :Soup ],
  [ owl:onProperty :has ; owl:minCardinality 2 ],
  {some("has", "[ owl:unionOf ( :A :B ) ]")} .
_:c owl:intersectionOf ( _:c :Pot ) . :Lid rdfs:subClassOf _:c .
:p a owl:FunctionalProperty .
""",
    )
    assert derived(graph) == {"Lid subClassOf Pot"}
    assert message.endswith(
        "nothing is read: 1 FunctionalProperty, 1 minCardinality, 2 someValuesFrom."
    )


def test_the_reasons_are_a_chain_of_stated_triples(tmp_path):
    axioms = f":Cup rdfs:subClassOf :Vessel, {some('usedFor', ':Drinking')} ."
    graph, _ = read(
        tmp_path, axioms + ":Mug rdfs:subClassOf :Cup . :m a :Mug ." + DISHES
    )
    base = "http://e.org/"
    dish = (base + "Teapot", SUBCLASS, base + "Dish")
    assert list(map(" ".join, graph.because(dish))) == [
        f"{base}Teapot {SUBCLASS} {base}Pot",
        f"{base}Pot {SUBCLASS} {base}Dish",
    ]
    used = (base + "m", base + "usedFor", base + "Drinking")
    (first, second, third) = graph.grounds(used)
    assert local([first]) == {"m type Mug"}
    assert local([second]) == {"Mug subClassOf Cup"}
    assert local([third]) == {"Cup usedFor Drinking"}
    stated = (base + "Pot", SUBCLASS, base + "Dish")
    assert graph.because(stated) == ()
    assert graph.grounds(stated) == (stated,)
    around = gamma(graph, ["m"])
    assert around.grounds(used) == (first, second, third)
    assert used not in around.stated()


def test_a_written_graph_is_read_as_the_same(tmp_path):
    axioms = f":Cup rdfs:subClassOf {some('usedFor', ':Drinking')} . :usedFor owl:inverseOf :by ."
    graph, _ = read(
        tmp_path, axioms + ":Mug rdfs:subClassOf :Cup ; owl:disjointWith :Pan ."
    )
    for name in ("again.ttl", "again.nt", "again.tsv", "again.csv", "again.rdf"):
        path = tmp_path / name
        write_graph(graph, path)
        again = read_graph(path)
        assert again == graph
        assert len(again.stated()) == len(graph.stated())
    part = gamma(graph, ["Mug"])
    write_graph(part, tmp_path / "part.ttl")
    assert set(part) <= set(read_graph(tmp_path / "part.ttl"))


@pytest.mark.parametrize("name", sorted(SHIPPED))
def test_nothing_follows_from_shipped_graphs(name):
    graph = read_graph(name)
    assert graph.derivations is None
    assert closed(graph) == (graph, "")
    assert closed(graph).graph is graph


def test_edits_change_what_follows(tmp_path):
    graph, _ = read(tmp_path, DISHES)
    base = "http://e.org/"
    changed = edited(graph, [f"- Pot {SUBCLASS} Dish", f"+ Lamp {SUBCLASS} {base}Pot"])
    assert derived(changed) == set()
    both = edited(changed, [f"+ Pot {SUBCLASS} Light"])
    assert "Teapot subClassOf Light" in derived(both)
    with pytest.raises(UserError, match=re.escape(
        "follows from others: Teapot subClassOf Pot; Pot subClassOf Dish. Remove one of these."
    )):  # fmt: skip
        edited(graph, [f"- Teapot {SUBCLASS} Dish"])
    first = graph_of([("a", SUBCLASS, "b")])
    second = graph_of([("b", SUBCLASS, "c")])
    together = union(first, second)
    assert ("a", SUBCLASS, "c") in together
    assert ("a", SUBCLASS, "c") not in difference(together, second)


def test_what_rests_on_doubtful_triples_is_as_doubtful(tmp_path):
    table = tmp_path / "a.tsv"
    lines = [
        "head\trelation\ttail\tconfidence",
        f"mug\t{SUBCLASS}\tcup\t.5",
        f"cup\t{SUBCLASS}\tvessel\t.5",
        f"cup\t{SUBCLASS}\tfood\t0",
        f"vessel\t{SUBCLASS}\tthing\t1",
        f"mug\t{SUBCLASS}\tjar\t.9",
        f"jar\t{SUBCLASS}\tvessel\t1",
    ]
    table.write_text("\n".join(lines))
    graph = read_graph(table)
    assert derived(graph) == {
        "mug subClassOf vessel",
        "mug subClassOf thing",
        "cup subClassOf thing",
        "jar subClassOf thing",
    }
    assert graph.confidence["mug", SUBCLASS, "vessel"] == pytest.approx(0.9)
    assert graph.confidence["mug", SUBCLASS, "thing"] == pytest.approx(0.9)
    assert graph.confidence["cup", SUBCLASS, "thing"] == pytest.approx(0.5)
    assert ("jar", SUBCLASS, "thing") not in graph.confidence
    assert graph.grounds(("mug", SUBCLASS, "thing"))[0] == ("mug", SUBCLASS, "jar")


@pytest.mark.parametrize(
    ("axiom", "facts", "follows"),
    [
        (("Mug", OWL + "disjointWith", "Food"), [("m", RDF_TYPE, "Mug")], ("m", "isNotA", "Food")),
        (("on", RDF_TYPE, OWL + "TransitiveProperty"), [("a", "on", "b"), ("b", "on", "c")],
         ("a", "on", "c")),
        (("on", OWL + "inverseOf", "under"), [("a", "on", "b")], ("b", "under", "a")),
        (("Tool", OWL + "unionOf", "_:l"),
         [("_:l", RDF + "first", "Mug"), ("_:l", RDF + "rest", RDF + "nil"),
          ("m", RDF_TYPE, "Mug")], ("m", RDF_TYPE, "Tool")),
    ],
)  # fmt: skip
def test_what_follows_from_a_doubtful_axiom_is_as_doubtful(axiom, facts, follows):
    doubtful = graph_of([axiom, *facts], confidence={axiom: 0.3})
    assert closed(doubtful).graph.confidence[follows] == pytest.approx(0.3)
    assert follows not in closed(graph_of([axiom, *facts])).graph.confidence


def test_vectors_and_drawings_leave_out_what_is_denied_by_axioms(tmp_path):
    axioms = ":Dish owl:disjointWith :Food, :Animal . :Mug rdfs:subClassOf :Dish ; :on :table ."
    graph, _ = read(tmp_path, axioms + " :Mug :notUsedFor :eating .")
    assert "Mug notSubClassOf Food" in derived(graph)
    drawn = draw_svg(graph, ["Mug"]).replace(" ", "").lower()
    assert "table" in drawn
    assert "eating" in drawn
    assert "subclassof" in drawn
    assert "notsubclassof" not in drawn
    config = KnowledgeConfig(detail="partial", graph=str(tmp_path / "home.ttl"))
    (words,) = scene_sentences(config, [("Mug", "")]).values()
    assert "table" in words
    assert "Food" not in words
    plain = graph.stated()
    assert set(without_derived(graph)) == set(plain) | {
        triple for triple in graph if triple not in plain and "not" not in triple[1]
    }


def test_the_surest_of_axioms_that_say_the_same_counts():
    first = ("Mug", OWL + "disjointWith", "Food")
    second = ("Food", OWL + "disjointWith", "Mug")
    member = ("m", RDF_TYPE, "Mug")
    graph = graph_of([first, second, member], confidence={first: 0.8, second: 0.3})
    both = closed(graph).graph.confidence
    assert both["m", "isNotA", "Food"] == pytest.approx(0.8)
    graph = graph_of([first, second, member], confidence={first: 0.3, second: 0.8})
    assert closed(graph).graph.confidence == pytest.approx(
        both | {first: 0.3, second: 0.8}
    )


def test_contradictions_are_said_and_nothing_is_dropped(tmp_path):
    axioms = ":Mug rdfs:subClassOf :Vessel, :Food . :Vessel owl:disjointWith :Food ."
    graph, (message,) = read(tmp_path, axioms)
    assert (
        "contradicts itself: 2 triples are both stated and denied, such as" in message
    )
    assert {"Mug subClassOf Food", "Mug notSubClassOf Food"} <= local(graph)


def test_too_many_conclusions_are_left_out_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(closure, "MOST", 50)
    chain = "".join(f":c{n} rdfs:subClassOf :c{n + 1} ." for n in range(30))
    graph, (message,) = read(tmp_path, chain)
    assert derived(graph) == set()
    assert "more than 50 triples, or one over more than 300 steps, follow" in message


def test_denials_of_subclasses_are_left_out_where_they_are_many(tmp_path, monkeypatch):
    monkeypatch.setattr(closure, "_FEW_DENIALS", 5)
    few = ":A owl:disjointWith :B ."
    for number in range(12):
        few += f":a{number} rdfs:subClassOf :A . :b{number} rdfs:subClassOf :B ."
    graph, (message,) = read(tmp_path, few)
    assert "a3 notSubClassOf B" in derived(graph)
    assert "a3 notSubClassOf b3" not in derived(graph)
    assert "disjoint classes deny each other" in message


def test_a_deep_file_needs_no_stack(tmp_path):
    lines = [f"_:c{n} owl:complementOf _:c{n + 1} ." for n in range(20_000)]
    graph, _ = read(
        tmp_path,
        ":Mug rdfs:subClassOf _:c0 . _:c20000 a owl:Class ." + "\n".join(lines),
    )
    assert derived(graph) == set()


def test_order_and_names_do_not_matter(tmp_path):
    lines = DISHES.strip().splitlines()
    first, _ = read(tmp_path, "\n".join(lines), "a.ttl")
    second, _ = read(tmp_path, "\n".join(reversed(lines)), "b.ttl")
    assert first == second
    for triple in first:
        assert first.because(triple) == second.because(triple)


def naive(triples):
    """Return the transitive and symmetric closure of triples, one pair at a time."""
    known = set(triples)
    while True:
        new = set()
        for h, r, t in known:
            for h2, r2, t2 in known:
                if r == r2 == SUBCLASS and t == h2 and h != t2:
                    new.add((h, SUBCLASS, t2))
                if r == "in" and r2 == "in" and t == h2:
                    new.add((h, "in", t2))
            if r == "near":
                new.add((t, r, h))
            if r == "in":
                new.add((h, "near", t))
        if new <= known:
            return known
        known |= new


def test_random_graphs_have_the_closure_of_a_slow_reasoner():
    owl = "http://www.w3.org/2002/07/owl#"
    kind = "http://www.w3.org/1999/02/22-rdf-syntax-ns#type"
    axioms = [
        ("in", kind, owl + "TransitiveProperty"),
        ("near", kind, owl + "SymmetricProperty"),
        ("in", "http://www.w3.org/2000/01/rdf-schema#subPropertyOf", "near"),
    ]
    for seed in range(thorough(20, 60)):
        generator = np.random.default_rng(seed)
        triples = list(axioms)
        for relation in generator.choice([SUBCLASS, "in", "near"], 12):
            head, tail = generator.choice(list("abcdefg"), 2, replace=False)
            triples.append((str(head), str(relation), str(tail)))
        graph = closed(graph_of(triples)).graph
        assert set(graph) == naive(triples)


def test_a_graph_without_axioms_is_the_same_object():
    assert closed(household()).graph is household()
