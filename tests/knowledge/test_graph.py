from collections import Counter, defaultdict
from itertools import product

import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.knowledge import graph_of, household
from knowarm.knowledge.formats import HOUSEHOLD
from knowarm.knowledge.graph.names import Names, Spellings
from knowarm.knowledge.graph.statistics import graph_statistics
from knowarm.knowledge.graph.terms import label_of, literal, local_name, name_key
from knowarm.world.config import EnvConfig
from knowarm.world.objects import TARGETS


def test_the_shipped_graph_holds_what_the_task_needs():
    graph = household()
    for name in EnvConfig().targets:
        for colour in TARGETS[name].colours:
            assert (name, "hasColor", colour) in graph
    objects = {head for head, relation, _ in graph if relation == "hasColor"}
    assert len(objects) >= 15
    assert len(graph) >= 400
    assert graph.own_labels()["cereal_box"] == "cereal box"
    used = {relation for _, relation, _ in graph}
    assert {
        "hasShape",
        "isMadeOf",
        "isConnectedTo",
        "usedFor",
        "graspedAt",
        "isLocatedIn",
    } <= used
    assert HOUSEHOLD.exists()


def test_names_are_found_by_bisection():
    words = sorted({"", "a", "aa", "b", "é", "mug", "cereal box", "😀"})
    names = Names(words)
    assert [names.find(word) for word in words] == list(range(len(words)))
    assert names.find("zz") is None
    assert names.find("aaa") is None
    assert Names().find("a") is None


def test_entities_by_iri_last_part_and_label():
    graph = graph_of(
        [("http://a.org/k#Mug01", "http://a.org/k#isA", "http://a.org/k#Cup")],
        labels={"http://a.org/k#Mug01": "my mug"},
    )
    full = graph.entity_id("http://a.org/k#Mug01")
    assert graph.entity_id("Mug01") == full
    assert graph.entity_id("my mug") == full
    assert graph.relation_id("isA") == 0
    with pytest.raises(UserError, match=r"Unknown entity 'Mug1'.*'Mug01'"):
        graph.entity_id("Mug1")


def test_duplicate_labels_are_ambiguous():
    graph = graph_of([("a:1", "r", "a:2")], labels={"a:1": "mug", "a:2": "mug"})
    with pytest.raises(
        UserError, match="'mug' names 2 entities of the graph: a:1, a:2"
    ):
        graph.entity_id("mug")
    assert graph_statistics(graph).same_labels == {"mug": ("1", "2")}
    same_end = graph_of([("http://a/x", "r", "http://b/x")])
    with pytest.raises(UserError, match=r"'x' names 2 entities.*Give the full name"):
        same_end.entity_id("x")


def test_statistics():
    graph = graph_of(
        [
            ("a", "isA", "b"),
            ("b", "isA", "c"),
            ("c", "isA", "a"),
            ("x", "isNextTo", "y"),
            ("y", "isNextTo", "x"),
            ("y", "isNextTo", "z"),
            ("z", "isNextTo", "y"),
        ],
        nodes=["alone"],
    )
    found = graph_statistics(graph)
    assert (found.triples, found.entities, found.relations) == (7, 7, 2)
    assert found.alone == 1
    assert found.components == 3
    assert found.hubs[0] == ("y", 4)
    assert found.by_relation == {"isNextTo": 4, "isA": 3}
    # IsNextTo is symmetric, not a cycle
    assert found.cycles == (("isA", ("a", "b", "c")),)


def test_labels():
    assert label_of("hasColor", {}) == "has color"
    assert label_of("light_blue", {}) == "light blue"
    assert label_of("http://www.w3.org/1999/02/22-rdf-syntax-ns#type", {}) == "is a"
    assert label_of("http://a.org/x#CerealBox", {}) == "cereal box"
    assert label_of("isMadeOfABS", {}) == "is made of abs"
    assert label_of('"Big Mug"@en', {}) == "big mug"
    assert label_of("m1", {"m1": "Light-Blue  Mug"}) == "light blue mug"


def test_short_names_are_those_that_are_shown():
    base = "http://a.org/"
    names = [
        f"{base}wine%20tasting",
        f"{base}light/",
        f"{base}k#Mug#",
        "coffee/tea",
        '"a/50%"',
    ]
    graph = graph_of([("mug", "isA", name) for name in names])
    for short, name in (
        ("wine tasting", names[0]),
        ("light", names[1]),
        ("Mug", names[2]),
    ):
        assert graph.names[graph.entity_id(short)] == name
        assert local_name(name) == short
    for short in ("tea", "wine%20tasting", "a/50%"):
        assert graph.find_entity(short) is None
    several = graph_of(
        [("http://a/x/", "http://a/r", "y"), ("http://b/x", "http://b/r", "y")]
    )
    for find in (several.find_entity, several.entity_id, several.find_relation):
        with pytest.raises(
            UserError, match=r"names 2 (entities|relations).*Give the full name"
        ):
            find("x" if find != several.find_relation else "r")


def test_every_spelling_is_found_as_by_looking_at_each_name():
    """Equal to the definition, on names of all kinds that are alike in every way."""
    rng = np.random.default_rng(0)
    words = ["mug", "Mugs", "coffee_mug", "CoffeeMug", "gas", "bus", "Straße", "ß"]
    beginnings = [
        "",
        "",
        "http://x#",
        "http://X#",
        "http://x/a/",
        "_:",
        "/c/en/",
        "a:b ",
    ]
    endings = ["", "", ".n.01", "/", "#", "%20a", "_"]
    made = product(beginnings, words, endings)
    names = sorted({"".join(parts) for parts in made} | {literal(w) for w in words})
    labelled = rng.choice(names, 60).tolist()
    labels = dict(zip(labelled, rng.choice(words, 60).tolist(), strict=True))
    spellings = Spellings(Names(names), labels)
    by_local = defaultdict(list)
    by_label = defaultdict(list)
    by_key = defaultdict(list)
    for index, name in enumerate(names):
        label = labels.get(name, name)
        if name in labels:
            by_label[label].append(index)
        if not name.startswith('"'):
            by_local[local_name(name)].append(index)
        if not name.startswith(('"', "_:")):
            for key in {name_key(local_name(name)), name_key(label), name_key(name)}:
                by_key[key].append(index)
    asked = [*names, *words, "MUG", "http://x#mugs", "HTTP://x#bus", "x#mug", "5", ""]
    for name in asked:
        alike = [by_local[name], by_label[name], by_key[name_key(name)]]
        assert list(spellings.alike(name)) == alike, name
    assert len(by_key[name_key("mug")]) > 20


def test_each_name_is_read_once_to_find_all(monkeypatch):
    graph = graph_of([(f"Cup_{i}", "isA", f"Kind {i % 7}") for i in range(500)])
    read = Counter()

    def noting(text):
        read[text] += 1
        return name_key(text)

    monkeypatch.setattr("knowarm.knowledge.graph.names.name_key", noting)
    for i in range(0, 500, 50):
        assert graph.find_entity(f"cup {i}") is not None
        assert graph.find_entity(f"kind{i % 7}") is not None
    own = {name: read[name] for name in graph.entities}
    assert set(own.values()) == {1}


def test_names_that_are_offered_end_with_whole_words():
    names = ("CoffeeMug", "http://x.org/Japan", "frying_pan", "span", "BigWineGlasses")
    spellings = graph_of((name, "a", "b") for name in names).entity_spellings
    assert spellings.near("mug") == ["CoffeeMug"]
    assert spellings.near("pan") == ["frying_pan"]
    assert spellings.near("wine_glass") == ["BigWineGlasses"]
