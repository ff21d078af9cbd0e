"""Homonyms, and individuals of classes: what the objects of a task stand for in a graph."""

import json
import warnings

import pytest

from knowarm.asking.answers import answer
from knowarm.asking.answers import words as words_of
from knowarm.cli.main import main
from knowarm.errors import DataWarning, UserError
from knowarm.experiment.knows import asked
from knowarm.experiment.other_graphs import meeting, with_graph
from knowarm.experiment.run_folder import RunFolder
from knowarm.knowledge import graph_of, read_graph
from knowarm.knowledge.graph.homonyms import find_object, is_class
from knowarm.knowledge.graph.terms import literal, numbered
from tests.source_tree import ROOT

pytestmark = pytest.mark.usefixtures("unfenced")

OBJECTS = ("mug", "bowl", "book", "brush", "pot", "teapot", "wine_glass")
FACETS = [(name, colour) for name in OBJECTS for colour in ("red", "blue")]
OBJECT, ACTION = "http://x.org/object#", "http://x.org/action/"
RDF_TYPE = "http://www.w3.org/1999/02/22-rdf-syntax-ns#type"
OWL_CLASS = "http://www.w3.org/2002/07/owl#Class"
SUBCLASS = "http://www.w3.org/2000/01/rdf-schema#subClassOf"

HOMONYM = """
@prefix o: <http://x.org/object#> . @prefix a: <http://x.org/action/> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
o:Brush rdfs:subClassOf o:Tool . o:Mug rdfs:subClassOf o:Dish .
a:brush a a:Action ; a:needs a:water .
"""
INSTANCES = """
@prefix : <http://x.org/> .
:obj17 a :Mug ; :on :table . :obj18 a :Mug ; :on :shelf . :obj19 a :Bowl ; :on :table .
"""
NUMBERED = "head,relation,tail\nmug_0,on,table\nbowl_0,on,shelf\nbook_0,on,shelf\n"


def read(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    return read_graph(path)


def names(graph, question, given=None):
    return {name for name, _ in answer(graph, FACETS, question, given).evidence}


def nobody(graph, question, match="No object of the task answers"):
    with pytest.raises(UserError, match=match) as error:
        answer(graph, FACETS, question)
    assert "\n" not in str(error.value)


def run(capsys, path, question, *options):
    """Return what `knowarm answer` prints, exit code first."""
    code = main(
        ["answer", question, "--graph", str(path), "--objects", *OBJECTS, *options]
    )
    return code, capsys.readouterr()


# Homonyms


def test_of_an_object_and_an_action_of_one_name_the_object_is_asked(tmp_path, capsys):
    path = tmp_path / "homonym.ttl"
    path.write_text(HOMONYM)
    out = tmp_path / "answers.json"
    code, said = run(capsys, path, "subClassOf Tool", "--json", str(out))
    assert code == 0
    assert {name for name, _ in json.loads(out.read_text())["answers"]} == {"brush"}
    assert said.err.count("'brush' is taken for http://x.org/object#Brush") == 1
    assert "http://x.org/action/brush. Give the full name" in said.err
    code, said = run(capsys, path, "type Action")
    assert code == 2
    assert "In the graph it is true of http://x.org/action/brush" in said.err
    graph = read_graph(path)
    assert names(graph, "type Action", {"brush": ACTION + "brush"}) == {"brush"}


CLASS_WINS = [
    [
        (OBJECT + "Mug", SUBCLASS, OBJECT + "Dish"),
        (OBJECT + "mug", OBJECT + "weight", literal("0.35")),
    ],
    [
        (OBJECT + "Mug", RDF_TYPE, OWL_CLASS),
        (OBJECT + "mug", OBJECT + "weight", literal("0.35")),
    ],
    [("x1", RDF_TYPE, OBJECT + "Mug"), (OBJECT + "mug", OBJECT + "weight", "heavy")],
    [
        (OBJECT + "MugWithLid", SUBCLASS, OBJECT + "Mug"),
        (OBJECT + "mug", OBJECT + "weight", "heavy"),
    ],
    [("Mug", "subClassOf", "Dish"), ("mug", "weight", "heavy")],
    [("obj3", "type", "Mug"), ("mug", "weight", "heavy"), ("mug", "on", "table")],
    [
        (OBJECT + "MUG", SUBCLASS, OBJECT + "Dish"),
        (ACTION + "mug", ACTION + "needs", ACTION + "coffee"),
    ],
    [
        (OBJECT + "M-u-g", SUBCLASS, OBJECT + "Dish"),
        (ACTION + "mug", ACTION + "needs", ACTION + "coffee"),
    ],
    [
        (OBJECT + "mug", SUBCLASS, OBJECT + "Dish"),
        (ACTION + "mug", ACTION + "needs", ACTION + "coffee"),
    ],
    [("Mug", "instanceOf", "Class"), ("mug", "weight", "heavy")],
    [("Mug", "isSubclassOf", "Dish"), ("mug", "a1", "x"), ("mug", "a2", "y")],
]


@pytest.mark.parametrize("triples", CLASS_WINS)
def test_the_class_is_meant_before_another_spelling(triples):
    graph = graph_of(triples)
    with pytest.warns(DataWarning, match="'mug' is taken for .*[Mm]-?[Uu]-?[Gg], and"):
        entity = find_object(graph, "mug")
    assert is_class(graph, entity)


@pytest.mark.parametrize(
    "triples",
    [
        [("Mug", "usedFor", "drinking"), ("Mug", "on", "t"), ("mug", "weight", "1")],
        [
            (OBJECT + "mug", OBJECT + "usedFor", "a"),
            (OBJECT + "mug", "p", "b"),
            (ACTION + "mug", "q", "c"),
        ],
    ],
)
def test_the_better_described_is_meant(triples):
    graph = graph_of(triples)
    with pytest.warns(DataWarning, match="is taken for .* and not for"):
        assert graph.names[find_object(graph, "mug")] == triples[0][0]


@pytest.mark.parametrize(
    "triples",
    [
        [(OBJECT + "mug", "p", "a"), (ACTION + "mug", "p", "b")],
        [("Mug", "p", "a"), ("mug", "p", "b")],
        [(OBJECT + "Mug", SUBCLASS, "a"), (ACTION + "mug", SUBCLASS, "b")],
    ],
)
def test_a_tie_is_refused_with_both_names(triples):
    graph = graph_of([*triples, ("bowl", "p", "a")])
    full = ", ".join(sorted(head for head, _, _ in triples))
    with pytest.warns(
        DataWarning, match=f"'mug' names 2 entities of the graph: {full}"
    ):
        assert names(graph, "p a or p b") == {"bowl"}
    other = triples[1]
    given = {"mug": other[0]}
    assert "mug" in names(graph, f"{other[1]} {other[2]}", given)


@pytest.mark.parametrize(
    "triples",
    [
        [("mug", "p", "a"), ("x", "contains", "Mug")],  # which states nothing
        [("mug", "p", "a"), ("mugs", "p", "b"), ("mugs", "q", "c")],
        [("mug", "p", "a"), ("mug.n.04", "p", "b"), ("mug.n.04", "q", "c")],
        [(OBJECT + "mug", RDF_TYPE, OBJECT + "Mug"), (OBJECT + "mug", "p", "a")],
    ],
)
def test_no_other_is_named_where_there_is_none(triples):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert names(graph_of(triples), "p a") == {"mug"}


@pytest.mark.parametrize(
    "triples",
    [
        [(ACTION + "brush", RDF_TYPE, ACTION + "Action")],
        [(ACTION + "brush", RDF_TYPE, ACTION + "HouseholdActivity")],
        [("Brush", "subClassOf", "CleaningEvent")],
        [("brush", "isA", "action")],
        [
            ("brush", "type", "Action"),
            ("brush", "type", "Event"),
            ("brush", "type", "Entity"),
        ],
    ],
)
def test_what_is_done_is_no_object(triples):
    name = triples[0][0]
    graph = graph_of([*triples, (name, "needs", "water"), ("bowl", "needs", "water")])
    with pytest.warns(
        DataWarning, match=f"'brush' is {name}.*of the kind '\\w+' and no object"
    ):
        assert names(graph, "needs water") == {"bowl"}
    assert names(graph, "needs water", {"brush": name}) == {"brush", "bowl"}


@pytest.mark.parametrize(
    ("kinds", "kind"),
    [
        (["Depressed Landform", "Material Entity"], "landform"),
        (["RockBand", "Group"], "band"),
        (["Newspaper", "Work"], "newspaper"),
        (["Person", "Thing"], "person"),
        (["RareDisease", "Condition"], "disease"),
        (["SoftwareCompany"], "company"),
        (["http://www.w3.org/2003/11/swrl#Variable"], "variable"),
        (["http://www.w3.org/2002/07/owl#ObjectProperty"], "property"),
    ],
)
def test_what_nobody_handles_is_no_object_whatever_else_it_is(kinds, kind):
    triples = [("brush", "isA", name) for name in kinds]
    graph = graph_of([*triples, ("brush", "in", "hall"), ("bowl", "in", "hall")])
    with pytest.warns(
        DataWarning, match=f"brush in the graph, of the kind '{kind}' and no"
    ):
        assert names(graph, "in hall") == {"bowl"}
    assert names(graph, "in hall", {"brush": "brush"}) == {"bowl", "brush"}
    # Another one of the name is meant
    tool = graph_of([*graph, ("Brush", "isA", "Tool"), ("Brush", "in", "hall")])
    with pytest.warns(
        DataWarning, match="'brush' is taken for Brush, and not for brush"
    ):
        assert find_object(tool, "brush") == tool.names.find("Brush")


def test_homonyms_of_many_names_are_one_line(tmp_path, capsys):
    lines = []
    for name in OBJECTS:
        lines += [f"{name.title()},subClassOf,Tool", f"{name},on,table"]
    lines.append("Mug,in,hall")
    path = tmp_path / "a.csv"
    path.write_text("\n".join(lines))
    code, said = run(capsys, path, "in hall")
    assert code == 0
    assert said.err.count("\n") == 1
    assert "Likewise 5 more names: book, brush, pot, teapot, wine_glass." in said.err
    main(["knowledge", "queries", "--graph", str(path), "--objects", *OBJECTS])
    assert capsys.readouterr().err.count("Likewise 5 more names") == 1


def test_a_tool_for_an_action_is_an_object():
    triples = [
        ("brush", "isA", "action"),
        ("brush", "isA", "tool"),
        ("brush", "p", "a"),
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert names(graph_of(triples), "p a") == {"brush"}


def test_actions_of_a_graph_alone_are_asked(tmp_path, capsys):
    path = tmp_path / "actions.csv"
    path.write_text(
        "swimming,type,Activity\nswimming,needs,water\nrowing,needs,water\n"
    )
    assert main(["answer", "needs water", "--graph", str(path)]) == 0
    said = capsys.readouterr()
    assert "swimming" in said.out
    assert said.err == ""


def test_values_are_those_that_the_relation_leads_to():
    graph = graph_of(
        [
            ("mug", "isA", OBJECT + "Dish"),
            (ACTION + "dish", ACTION + "needs", ACTION + "time"),
            (ACTION + "dish", ACTION + "on", ACTION + "menu"),
            ("bowl", "on", ACTION + "dish"),
            ("book", "usedFor", "Reading"),
            ("pot", "usedFor", "reading"),
        ]
    )
    assert names(graph, "isA dish") == {"mug"}
    assert names(graph, "on Dish") == {"bowl"}
    assert names(graph, "usedFor reading") == {"book", "pot"}
    both = graph_of([("mug", "isA", OBJECT + "Dish"), ("bowl", "isA", ACTION + "dish")])
    with pytest.warns(
        DataWarning, match="taken for http://x.org/action/dish, and not for"
    ):
        assert names(both, "isA dish") == {"bowl"}
    assert names(both, f"isA {OBJECT}Dish") == {"mug"}
    alike = graph_of(
        [("mug", "isA", OBJECT + "dish"), ("bowl", "isA", ACTION + "dish")]
    )
    nobody(alike, "isA dish", match="'dish' names 2 entities")
    assert names(both, f"isA {ACTION}dish") == {"bowl"}


def test_the_objects_of_a_graph_are_one_of_each_name(tmp_path, capsys):
    path = tmp_path / "a.csv"
    path.write_text("Mug,subClassOf,Dish\nmug,weight,heavy\nbowl,weight,heavy\n")
    assert main(["answer", "weight heavy", "--graph", str(path)]) == 0
    said = capsys.readouterr()
    assert "bowl" in said.out
    assert "mug" not in said.out
    assert "'Mug' is taken for Mug" in said.err


# Individuals


def test_individuals_of_a_class_answer(tmp_path, capsys):
    path = tmp_path / "instances.ttl"
    path.write_text(INSTANCES)
    code, said = run(capsys, path, "something on the table")
    assert code == 0
    assert "mug" in said.out
    assert "bowl" in said.out
    graph = read_graph(path)
    assert names(graph, "on table") == {"mug", "bowl"}
    assert names(graph, "on shelf") == {"mug"}
    assert answer(graph, FACETS, "on shelf").evidence["mug", "red"] == (
        "obj18 on shelf",
    )
    assert names(graph, "not on table") == {"mug"}  # the other mug
    assert names(graph, "on table and is mug") == {"mug"}
    assert names(graph, "is bowl") == {"bowl"}
    assert names(
        graph, "SELECT ?object { ?object <http://x.org/on> <http://x.org/table> }"
    ) == {
        "mug",
        "bowl",
    }
    assert words_of(graph, FACETS)["on"] == {"table": ["mug", "bowl"], "shelf": ["mug"]}


@pytest.mark.parametrize(
    ("question", "condition"),
    [
        ("something on the table", "ON table"),
        ("bring the mug on the table", "is mug and ON table"),
        ("the mug that is not on the table", "is mug and not ON table"),
        ("the red mug on the table", "hasColor red and is mug and ON table"),
    ],
)
@pytest.mark.parametrize("table", ["table_4", "obj4"])
def test_places_are_said_by_their_class(question, condition, table):
    things = [("mug_1", "type", "mug"), (table, "type", "table")]
    graph = graph_of([*things, ("mug_1", "ON", table), ("mug_2", "type", "mug")])
    answers = answer(graph, FACETS, question)
    assert answers.question == condition
    assert {name for name, _ in answers.evidence} == {"mug"}


def test_individuals_by_name_answer(tmp_path, capsys):
    path = tmp_path / "names.csv"
    path.write_text(NUMBERED)
    code, said = run(capsys, path, "on table")
    assert code == 0
    assert "mug" in said.out
    assert "bowl" not in said.out
    graph = read_graph(path)
    assert answer(graph, FACETS, "on table").evidence["mug", "blue"] == (
        "mug_0 on table",
    )
    assert names(graph, "something on the shelf") == {"bowl", "book"}
    nobody(graph_of([("mug_0", "on", "table"), ("cup_1", "on", "shelf")]), "on shelf",
           match="In the graph it is true of cup_1: no object stands for that")  # fmt: skip


@pytest.mark.parametrize(
    "name",
    [
        "mug_0",
        "mug1",
        "mug.001",
        "mug-2",
        "mug 3",
        "Mug_12ab",
        "Mug_n8p9V6",
        "MUG_07",
        "mug (173)",
        "<mug> (173)",
        "mug#4",
        "Mug|-00.53|+01.15|+00.10",
        "Mug|surface|5|17",
        "mug_550e8400-e29b-41d4-a716-446655440000",
        "http://knowrob.org/kb/knowrob.owl#Mug_abcd1234",
        "http://x.org/mug/mug_3",
    ],
)
def test_names_of_individuals(name):
    graph = graph_of([(name, "on", "table")])
    assert names(graph, "on table") == {"mug"}


@pytest.mark.parametrize(
    "name",
    [
        "mug_rack",
        "mug_rack_1",
        "mug_rack1",
        "mug_2019",
        "mug2019",
        "mug_500ml",
        "mug_3d",
        "mug_1_handle",
        "mug_cafe",
        "mug_v2",
        "3mug",
        "smug_1",
        "mugshot_2",
        "travel_mug_1",
        "mug_1_2",
    ],
)
def test_false_friends_are_no_individuals(name):
    graph = graph_of([(name, "on", "table"), ("bowl", "on", "shelf")])
    nobody(graph, "on table")


@pytest.mark.parametrize("name", ["7up", "mug.n.04", "2001", "mug", "", "_", "1_2"])
def test_names_without_a_number_behind_a_word(name):
    assert numbered(name) is None


@pytest.mark.parametrize(
    ("triples", "is_one"),
    [
        # Facts about "book" and "book2" are facts about two things of a data set
        ([("book", "usedFor", "reading"), ("book2", "on", "table")], False),
        ([("Book", "usedFor", "reading"), ("book2", "on", "table")], False),
        ([("shelf", "contains", "book"), ("book2", "on", "table")], True),
        ([("book", "usedFor", "reading"), ("book_2", "on", "table")], True),
        ([("book2", "type", "picture"), ("book2", "on", "table")], False),
        ([("book_2", "type", "picture"), ("book_2", "on", "table")], False),
        ([("book_2", RDF_TYPE, "http://www.w3.org/2002/07/owl#NamedIndividual"),
          ("book_2", "on", "table")], True),
        ([("book_2", "subClassOf", "novel"), ("book_2", "on", "table")], False),
        ([("obj17", "isA", "book"), ("obj17", "on", "table")], True),
        ([("comic", "isA", "book"), ("comic", "on", "table")], False),
        ([("obj17", "class", "book"), ("obj17", "on", "table")], True),
        ([("obj17", "type", "Book"), ("obj17", "on", "table")], True),
        ([("obj17", "type", "novel"), ("novel", "subClassOf", "book"),
          ("obj17", "on", "table")], True),
    ],
)  # fmt: skip
def test_what_is_an_individual(triples, is_one):
    graph = graph_of([*triples, ("bowl", "on", "shelf")])
    if is_one:
        assert names(graph, "on table") == {"book"}
    else:
        nobody(graph, "on table")


def test_an_uncertain_type_is_none():
    types = [("obj1", "type", "mug"), ("obj2", "type", "bowl")]
    graph = graph_of(
        [*types, ("obj1", "on", "table"), ("obj2", "on", "table")],
        confidence={types[0]: 0.4, types[1]: 0.6},
    )
    assert names(graph, "on table") == {"bowl"}


def test_an_individual_belongs_to_the_object_of_its_nearest_class():
    triples = [
        ("Teapot", "subClassOf", "Pot"),
        ("obj1", "type", "Teapot"),
        ("obj2", "type", "Pot"),
        ("obj1", "on", "table"),
        ("obj2", "on", "shelf"),
        ("kettle_1", "type", "Kettle"),  # which is no object here
        ("Kettle", "subClassOf", "Pot"),
        ("kettle_1", "on", "stove"),
    ]
    for follows in ([], [("obj1", "type", "Pot")]):
        graph = graph_of([*triples, *follows])
        assert names(graph, "on table") == {"teapot"}
        assert names(graph, "on shelf") == {"pot"}
        assert names(graph, "on stove") == {"pot"}


SCENE = graph_of(
    [
        ("mug", "usedFor", "drinking"),
        ("mug", "isLocatedIn", "kitchen"),
        ("mug", "hasPart", "handle"),
        ("mug_0", "isLocatedIn", "garden"),
        ("mug_0", "hasColor", "dark red"),
        ("mug_0", "notUsedFor", "drinking"),
        ("mug_0", "hasPart", "handle"),
        ("mug_0", "hasPart", "lid"),
        ("mug_1", "hasColor", "blue"),
        ("mug_1", "on", "table_3"),
        ("table_3", "isLocatedIn", "hall"),
        ("bowl_2", "type", "bowl"),
        ("bowl_2", "hasColor", "white"),
        ("bowl_2", "on", "table_3"),
        ("bowl", "usedFor", "eating"),
        ("book_4", "hasColor", "Book_4_Color"),
        ("book_4", "on", "table_3"),
    ]
)


@pytest.mark.parametrize(
    ("question", "expected"),
    [
        # The class says what is said of all mugs, an individual says otherwise
        ("usedFor drinking", {("mug", "blue"): "mug usedFor drinking"}),
        ("not usedFor drinking and is mug", {("mug", "red"): "mug_0 notUsedFor drinking"}),
        ("isLocatedIn kitchen", {("mug", "blue"): "mug isLocatedIn kitchen"}),
        ("isLocatedIn garden", {("mug", "red"): "mug_0 isLocatedIn garden"}),
        ("count hasPart = 2", {("mug", "red"): "mug_0 hasPart handle"}),
        ("count hasPart = 1", {("mug", "blue"): "mug hasPart handle"}),
        # What is white is neither of the bowls that are seen, but they are bowls
        ("usedFor eating", {("bowl", "red"): "bowl usedFor eating",
                            ("bowl", "blue"): "bowl usedFor eating"}),
        ("on table", {("mug", "blue"): "mug_1 on table_3",
                      ("book", "red"): "book_4 on table_3",
                      ("book", "blue"): "book_4 on table_3"}),
        ("on (isLocatedIn hall) and hasColor red", {("book", "red"): "book_4 on table_3"}),
    ],
)  # fmt: skip
def test_an_individual_has_its_own_facts_and_those_of_its_class(question, expected):
    evidence = answer(SCENE, FACETS, question).evidence
    assert {facet: evidence[facet][0] for facet in evidence} == expected


SUPERLATIVES = graph_of(
    [
        ("Mug", "hasPart", "handle"),
        ("Mug", "hasPart", "lid"),
        ("mug_1", RDF_TYPE, "Mug"),
        ("mug_1", "hasPart", "rim"),
        ("Bowl", "hasPart", "neck"),
        ("Bowl", "hasPart", "base"),
        ("Mug", "price", '"1234567"'),
        ("Bowl", "price", '"3"'),
    ]
)


@pytest.mark.parametrize(
    ("question", "read_as", "expected"),
    [
        ("the object with the most parts", "count hasPart = 3", {"mug"}),
        ("the one with the fewest parts", "count hasPart = 2", {"bowl"}),
        ("the mug with the fewest parts", "is mug and count hasPart = 3", {"mug"}),
        ("the most expensive object", "price = 1234567", {"mug"}),
        ("the cheapest mug", "is mug and price = 1234567", {"mug"}),
        ("the cheapest object", "price = 3", {"bowl"}),
    ],
)
def test_superlatives_count_what_an_individual_and_its_class_have_together(
    question, read_as, expected
):
    found = answer(SUPERLATIVES, FACETS, question)
    assert found.question == read_as
    assert {name for name, _ in found.evidence} == expected


def test_given_names_are_classes_or_individuals():
    graph = graph_of(
        [
            ("CoffeeMug_1", "on", "table"),
            ("CoffeeMug_2", "on", "shelf"),
            ("obj7", "type", "Cup"),
            ("Cup", "usedFor", "drinking"),
        ]
    )
    assert names(graph, "on table", {"mug": "CoffeeMug"}) == {"mug"}
    assert names(graph, "on shelf", {"mug": "CoffeeMug"}) == {"mug"}
    assert names(graph, "usedFor drinking", {"mug": "Cup"}) == {"mug"}
    assert names(graph, "usedFor drinking", {"mug": "obj7"}) == {"mug"}
    with pytest.raises(UserError, match="Unknown entity 'TeaMug'"):
        answer(graph, FACETS, "on table", {"mug": "TeaMug"})


def test_an_object_of_individuals_alone_counts_as_described():
    graph = graph_of([("mug_0", "on", "table"), ("spoon", "on", "shelf")])
    assert meeting(graph, OBJECTS[:2]) == {
        "recognized and described": ["mug"],
        "recognized only": ["bowl"],
        "described only": ["spoon"],
    }


def test_an_evaluation_shows_what_the_question_means(tmp_path):
    lines = ["brush,needs,water", "Brush,subClassOf,Tool", "Brush,weight,heavy"]
    for name in ("bowl", "book", "pot", "teapot", "lamp", "vase"):
        lines += [f"{name},weight,heavy"] * (name < "n") + [f"{name},on,table"]
    lines += [f"{name},subClassOf,Tool" for name in ("lamp", "vase")]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(lines))
    config = RunFolder.open(ROOT / "zoo" / "irb120-choose-answers-fast").experiment()
    with pytest.warns(DataWarning, match="'brush' is taken for Brush"):
        changed = with_graph(config, str(path))
    queries = set(map(str, asked(changed.env).queries))
    assert "subClassOf Tool" in queries
    assert "needs water" not in queries


def changed_by(tmp_path, text, names=None, suffix=".csv"):
    """Return the experiment of a shipped policy that another graph asks."""
    path = tmp_path / f"a{suffix}"
    path.write_text(text)
    config = RunFolder.open(ROOT / "zoo" / "irb120-choose-answers-fast").experiment()
    return with_graph(config, str(path), names)


OTHERS = [f"{name},on,table" for name in ("book", "pot", "teapot", "lamp")]
SCENES = {
    "of names": ["mug_0,on,table_1", "mug_0,state,clean", "mug_1,on,shelf", "bowl_1,on,shelf"],
    "of types": ["obj1,type,Mug", "obj1,on,shelf", "obj2,type,Bowl", "obj2,inside,cupboard"],
    "with classes": ["mug_0,on,shelf", "mug,usedFor,drinking", "mug,on,table", "bowl,on,floor"],
    "of one colour": ["mug_0,color,red", "mug_0,on,shelf", "mug_1,on,sink", "mug_1,color,blue"],
    "of kinds": ["o1,type,CoffeeMug", "CoffeeMug,subClassOf,Mug", "o1,state,dirty", "o2,type,Bowl"],
    "contradicting": ["mug,usedFor,drinking", "mug_0,notUsedFor,drinking", "bowl,usedFor,drinking"],
    "on individuals": ["mug_0,on,desk_4", "desk_4,type,Desk", "bowl_0,on,desk_5"],
    "of cameras": ["Mug|-00.5|+01.1,isLocatedIn,sink", "mug.001,isLocatedIn,shelf"],
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::knowarm.errors.DataWarning")
@pytest.mark.parametrize("lines", SCENES.values(), ids=SCENES)
def test_an_evaluation_asks_what_ask_answers_of_individuals(tmp_path, lines):
    changed = changed_by(tmp_path, "\n".join([*OTHERS, *lines]))
    assert "mug" in changed.env.targets
    table = asked(changed.env)
    graph = read_graph(changed.env.task.asked.graph)
    of_individuals = set()
    for query, satisfies in zip(table.queries, table.satisfies, strict=True):
        found = answer(graph, table.facets, str(query))
        assert found.satisfies.tolist() == satisfies.tolist(), str(query)
        of_individuals.update(str(reason) for reason in found.evidence.values())
    told = " ".join(of_individuals)
    subjects = {line.split(",")[0] for line in lines if line[0] in "mMo"}
    assert any(f"'{subject} " in told for subject in subjects)


def test_an_evaluation_asks_for_the_place_of_an_individual(tmp_path):
    lines = [
        "mug_0,on,shelf",
        "mug,on,table",
        "bowl_0,on,table_7",
        "table_7,type,Table",
    ]
    lines += ["lamp,nextTo,mug_0"]
    changed = changed_by(tmp_path, "\n".join([*OTHERS, *lines]))
    table = asked(changed.env)
    answers = {}
    for query, satisfies in zip(table.queries, table.satisfies, strict=True):
        answers[str(query)] = {table.facets[f][0] for f in satisfies.nonzero()[0]}
    assert answers["on shelf"] == {"mug"}
    assert answers["on table"] == {
        "book",
        "pot",
        "teapot",
        "lamp",
        "bowl",
    }  # no mug does
    assert answers["on table_7"] == {"bowl"}
    assert "nextTo mug_0" not in answers  # a query never names an object


def test_given_names_of_individuals_are_evaluated(tmp_path):
    lines = [*OTHERS, "CoffeeMug_1,on,shelf", "CoffeeMug_2,on,floor", "bowl_3,on,shelf"]
    changed = changed_by(tmp_path, "\n".join(lines), {"mug": "CoffeeMug"})
    assert "mug" in changed.env.targets
    table = asked(changed.env)
    names = list(map(str, table.queries))
    satisfies = table.satisfies[names.index("on floor")]
    assert {table.facets[f][0] for f in satisfies.nonzero()[0]} == {"mug"}
    with pytest.raises(UserError, match="Unknown entity 'TeaMug'"):
        changed_by(tmp_path, "\n".join(lines), {"mug": "TeaMug"})


def test_an_evaluation_with_given_names_keeps_confidence(tmp_path, monkeypatch):
    monkeypatch.setenv("KNOWARM_CACHE", str(tmp_path))
    lines = ["head,relation,tail,confidence", "Cup,on,table,0.3", "Cup,on,shelf,0.8"]
    lines += [
        f"{name},on,table,1" for name in ("bowl", "book", "pot", "teapot", "lamp")
    ]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(lines))
    config = RunFolder.open(ROOT / "zoo" / "irb120-choose-answers-fast").experiment()
    changed = with_graph(config, str(path), {"mug": "Cup"})
    graph = read_graph(changed.env.task.asked.graph)
    assert graph.confidence == {
        ("Cup", "on", "table"): 0.3,
        ("Cup", "on", "shelf"): 0.8,
    }
    assert "mug" in changed.env.targets
