"""Names that are spelled otherwise, are labels, belong to several things, or are numbers."""

import pytest

from knowarm.asking.answers import answer
from knowarm.errors import DataWarning, UserError
from knowarm.knowledge import graph_of, read_graph
from knowarm.knowledge.graph.edits import edited
from knowarm.knowledge.graph.graph import gamma
from knowarm.knowledge.graph.homonyms import find_objects
from knowarm.knowledge.graph.names import AmbiguousNameError
from knowarm.knowledge.graph.terms import literal, name_key
from knowarm.knowledge.queries.queries import QueryGraph
from tests.knowledge.ontologies import KITCHEN, read

A, B, E = "http://a.org/", "http://b.org/", "http://e.org/"
FACETS = [(name, c) for name in ("mug", "wine_glass", "pot") for c in ("blue", "red")]


def names(graph, text, given=None):
    return {name for name, _ in answer(graph, FACETS, text, given).evidence}


@pytest.mark.parametrize(
    "spellings",
    [
        "wine_glass|WineGlass|wine glass|Wine-Glasses|wineglass.n.01|wine_glass.o|WINE GLASS",
        "mug|Mug|mugs|mug.n.04",
        "cookie|Cookies|cooky",
        "berry|berries",
        "box|boxes",
        "tomato|tomatoes",
        "caf\u00e9|cafe\u0301|Cafés",
        "glass|glasses",
    ],
)
def test_spellings_of_one_name(spellings):
    assert len({name_key(each) for each in spellings.split("|")}) == 1


@pytest.mark.parametrize(
    "other", ["5|-5", "5|5.0", "mug|mugger", "can|cane", "bus|bu", "C|C++", "gas|ga"]
)
def test_spellings_of_two_names(other):
    one, two = other.split("|")
    assert name_key(one) != name_key(two)


def test_the_nearest_spelling_counts():
    graph = graph_of(
        [
            ("mug", "p", "a"),
            ("Mug", "p", "b"),
            (E + "Cup", "p", "a"),
            ("cups", "p", "b"),
        ]
    )
    assert graph.names[graph.entity_id("mug")] == "mug"
    assert graph.names[graph.entity_id("Mug")] == "Mug"
    assert graph.names[graph.entity_id("Cup")] == E + "Cup"
    assert graph.names[graph.entity_id("cups")] == "cups"
    for name, message in (
        ("MUG", "'MUG' names 2 entities of the graph: Mug, mug"),
        ("cup", "2 ent"),
    ):
        with pytest.raises(AmbiguousNameError, match=message):
            graph.find_entity(name)
    part = gamma(graph, ["mug"])  # which holds one of them only
    assert part.names[part.entity_id("MUG")] == "mug"


def test_labels_are_names_in_any_spelling():
    labels = {
        E + "Q1": "Mug",
        E + "Q2": "drinking",
        E + "Q4": "wine glass",
        E + "P1": "usedFor",
    }
    graph = graph_of(
        [(E + "Q1", E + "P1", E + "Q2"), (E + "Q4", E + "P1", E + "Q2")], labels=labels
    )
    assert names(graph, "usedFor drinking") == {"mug", "wine_glass"}
    assert names(graph, "P1 Q2") == {"mug", "wine_glass"}


def test_edits_name_what_is_there_in_any_spelling():
    graph = graph_of([("Mug", "usedFor", "Drinking")])
    assert ("Mug", "usedFor", "tea") in edited(graph, ["+ mug UsedFor tea"])
    assert len(edited(graph, ["- mugs usedfor drinking"])) == 0


def test_an_ambiguous_object_is_not_described_and_blocks_no_question():
    triples = [
        (A + "mug", A + "usedFor", A + "drinking"),
        (B + "mug", B + "color", B + "red"),
    ]
    graph = graph_of([*triples, (A + "pot", A + "usedFor", A + "cooking")])
    message = (
        "'mug' names 2 entities of the graph: "
        "http://a.org/mug, http://b.org/mug.*not described"
    )
    with pytest.warns(DataWarning, match=message):
        assert names(graph, "usedFor cooking or usedFor drinking") == {"pot"}
    assert names(graph, "usedFor drinking", {"mug": A + "mug"}) == {"mug"}


def test_given_names():
    graph = graph_of(
        [("coffee_cup", "usedFor", "drinking"), ("mug", "usedFor", "writing")]
    )
    assert names(graph, "usedFor drinking", {"mug": "CoffeeCup"}) == {"mug"}
    assert names(
        graph, "SELECT ?object { ?object :usedFor :drinking }", {"mug": "CoffeeCup"}
    ) == {"mug"}
    with pytest.raises(
        UserError, match=r"object of the task 'mugg'\. Did you mean 'mug'"
    ):
        answer(graph, FACETS, "usedFor drinking", {"mugg": "x"})
    with pytest.raises(UserError, match="Unknown entity 'teacup'"):
        answer(graph, FACETS, "usedFor drinking", {"mug": "teacup"})


def test_near_names_are_offered():
    others = [
        (E + "MugShot", E + "isA", E + "Picture"),
        (E + "Smugness", E + "isA", E + "Mood"),
    ]
    graph = graph_of([(E + "CoffeeMug", E + "usedFor", E + "drinking"), *others])
    with pytest.raises(
        UserError, match=r"none of the 3 objects.*names='mug=CoffeeMug'"
    ):
        answer(graph, FACETS, "usedFor drinking")
    with pytest.raises(UserError, match="names='mug=MyMug'"):
        answer(graph_of(others), FACETS, "usedFor drinking")


THINGS = graph_of(
    [
        ("mug", "price", literal("5")),
        ("pot", "price", literal("12.5")),
        ("wine_glass", "price", "7"),
        ("mug", "made", literal("2020-01-01")),
        (
            "pot",
            "made",
            literal("2021-06-30", datatype="http://www.w3.org/2001/XMLSchema#date"),
        ),
        ("mug", "material", literal("Ceramic")),
        (
            "mug",
            "isFragile",
            literal("true", datatype="http://www.w3.org/2001/XMLSchema#boolean"),
        ),
        ("mug", "note", literal("a\nb")),
    ]
)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("price 5", {"mug"}),
        ("price 5.00", {"mug"}),
        ("price = 7", {"wine_glass"}),
        ("price == 12.50", {"pot"}),
        ("price != 7", {"mug", "pot"}),
        ("price > 5", {"wine_glass", "pot"}),
        ("price>=5 and not price<7", {"wine_glass", "pot"}),
        ("price <= 7 and hasColor red", {"mug", "wine_glass"}),
        ("count price != 0", {"mug", "wine_glass", "pot"}),
        ("made > 2020-12-31", {"pot"}),
        ("made 2020-01-01", {"mug"}),
        ("material ceramic", {"mug"}),
        ("isFragile true", {"mug"}),
    ],
)
def test_numbers_dates_and_texts_are_asked(text, expected):
    assert names(THINGS, text) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("price 6", "Unknown value of price '6'.*Available: 12.5, 5, 7"),
        ("price > cheap", "expected a number or a date"),
        ("price >", "expected a number or a date"),
        ("price > 2020-01-01", "the graph states no date by price"),
        ("made > 2020", "the graph states no number by made"),
        ("material > 5", "the graph states no number by material"),
        (
            "hasColor turquoise",
            "Unknown value of hasColor 'turquoise'.*Available: blue, red",
        ),
    ],
)
def test_a_number_that_cannot_be_compared_is_refused_in_one_line(text, message):
    with pytest.raises(UserError, match=message) as error:
        answer(THINGS, FACETS, text)
    assert "\n" not in str(error.value)


def test_colours_in_any_spelling():
    for text in ("hasColor Red", "hascolor red", "hasColour RED", "has_color red"):
        found = answer(THINGS, FACETS, text).evidence
        assert set(found) == {(name, "red") for name in ("mug", "wine_glass", "pot")}
        assert set(found.values()) == {("the image shows red",)}


def test_sparql_sees_colours_as_the_graph_names_them():
    shown = [("mug", "hasColor", E + "Blue"), ("pot", "hasColor", literal("red"))]
    graph = graph_of([*shown, (A + "red", "isA", "x"), (B + "red", "isA", "y")])
    text = f"SELECT ?object {{ ?object :hasColor <{E}Blue> }}"
    assert set(answer(graph, FACETS, text).evidence) == {
        ("mug", "blue"),
        ("pot", "blue"),
    }
    for red in ('"red"', f"<{A}red>", f"<{B}red>"):
        found = answer(graph, FACETS, f"SELECT ?object {{ ?object :hasColor {red} }}")
        assert set(found.evidence) == {("mug", "red"), ("pot", "red")}
    both = answer(graph, FACETS, "SELECT ?object ?colour { ?object :hasColor ?colour }")
    assert len(both.evidence) == 4


def test_queries_keep_names_of_one_last_part_apart_and_leave_out_blank_nodes(tmp_path):
    path = tmp_path / "a.ttl"
    path.write_text(
        "@prefix c: <http://c.net/c/en/> . @prefix r: <http://c.net/r/> .\n"
        "<http://c.net/c/en/cider/n> r:IsA c:drink . <http://c.net/c/en/stein/n> r:IsA c:mug .\n"
        "c:cup r:UsedFor c:drinking ; r:hasPart [ r:isA c:handle ] ."
    )
    graph = read_graph(path)
    heads = [name for name, _, _ in graph if not name.startswith("_:")]
    shown = [graph.names.short(graph.entity_id(name)) for name in heads]
    assert set(shown) == {
        "http://c.net/c/en/cider/n",
        "http://c.net/c/en/stein/n",
        "cup",
    }
    asked = QueryGraph(graph, [(name, "red") for name in dict.fromkeys(shown)])
    assert [c.name for c in asked.conditions] == [
        "IsA drink",
        "IsA mug",
        "UsedFor drinking",
        "hasColor red",
    ]


def test_what_axioms_of_owl_say_is_asked(tmp_path):
    graph, _ = read(tmp_path, KITCHEN)
    facets = [(name, "red") for name in ("mug", "spoon", "teacup")]
    assert {n for n, _ in answer(graph, facets, "usedFor drinking").evidence} == {
        "mug",
        "teacup",
    }
    assert {n for n, _ in answer(graph, facets, "price < 6").evidence} == {"spoon"}


SENSES = [
    ("mug.n.04", "_hypernym", "drinking_vessel.n.01"),
    ("mug.v.01", "_hypernym", "rob.v.01"),
    ("mug.v.01", "_verb_group", "rob.v.02"),
    ("pitcher.n.01", "_hypernym", "ballplayer.n.01"),
    ("ballplayer.n.01", "_hypernym", "athlete.n.01"),
    ("athlete.n.01", "_hypernym", "person.n.01"),
    ("bowl.n.01", "_hypernym", "vessel.n.03"),
    ("bowl.n.03", "_hypernym", "crockery.n.01"),
    ("bowl.n.03", "_has_part", "rim.n.01"),
    ("clock.v.01", "_hypernym", "time.v.01"),
]


def test_an_object_is_no_verb_no_person_and_none_of_several_senses_of_wordnet():
    graph = graph_of(SENSES)
    objects = ("mug", "pitcher", "bowl", "clock")
    with pytest.warns(DataWarning) as warned:
        found = find_objects(graph, objects)
    assert graph.names[found["mug"]] == "mug.n.04"
    assert (found["pitcher"], found["bowl"], found["clock"]) == (None, None, None)
    text = " ".join(str(warning.message) for warning in warned)
    assert "pitcher.n.01 in the graph, of the kind 'person' and no object" in text
    assert find_objects(graph, ["bowl.n.03"])["bowl.n.03"] is not None


def test_senses_are_read_where_nothing_stands_above_them():
    circle = [
        ("mug.n.04", "hypernym", "cup.n.01"),
        ("cup.n.01", "hypernym", "mug.n.04"),
    ]
    for triples in (circle, [("mug.n.04", "hasAbility", "fillable")]):
        graph = graph_of(triples)
        assert graph.names[find_objects(graph, ["mug"])["mug"]] == "mug.n.04"
