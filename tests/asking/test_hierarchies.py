"""Questions to ontologies: what follows answers, and the evidence says from what."""

import pytest

from knowarm.asking.answers import answer
from knowarm.errors import UserError
from tests.knowledge.ontologies import DISHES, read, some

pytestmark = pytest.mark.usefixtures("unfenced")


def test_questions_follow_the_hierarchy(tmp_path):
    graph, _ = read(tmp_path, DISHES + ":Light owl:disjointWith :Dish .")
    facets = [(name, "red") for name in ("teapot", "bowl", "lamp")]

    def names(text):
        return {name for name, _ in answer(graph, facets, text).evidence}

    assert names("subClassOf Dish") == {"teapot", "bowl"}
    assert names("not subClassOf Dish") == {"lamp"}
    assert names("is dish") == {"teapot", "bowl"}
    assert names("not is dish") == {"lamp"}
    assert names("a dish") == {"teapot", "bowl"}
    assert names("something that is not a dish") == {"lamp"}
    evidence = answer(graph, facets, "subClassOf Dish").evidence["teapot", "red"]
    assert evidence == (
        "Teapot subClassOf Dish because Teapot subClassOf Pot, Pot subClassOf Dish",
    )
    denied = answer(graph, facets, "not subClassOf Dish")
    assert denied.stated.tolist() == [False, False, True]


def test_kinds_that_several_relations_state_are_asked_as_one(tmp_path):
    text = DISHES + ":Light owl:disjointWith :Dish . :b1 a :Bowl . :l1 a :Lamp ."
    graph, _ = read(tmp_path, text)
    facets = [(name, "red") for name in ("teapot", "bowl", "lamp")]
    for question, expected in {
        "a dish": {"teapot", "bowl"},
        "something that is not a dish": {"lamp"},
        "the dishes that are not bowls": {"teapot"},
        "a light or a pot": {"lamp", "teapot"},
    }.items():
        found = answer(graph, facets, question)
        assert {name for name, _ in found.evidence} == expected, question
        assert "subClassOf" not in found.question


def test_a_class_above_the_class_above_is_one_too(tmp_path):
    text = ":Mug rdfs:subClassOf :Cup . :Cup rdfs:subClassOf :Container ."
    graph, _ = read(tmp_path, text + ":Bowl rdfs:subClassOf :Container .")
    facets = [(name, "red") for name in ("mug", "bowl")]
    for question in ("a container", "subClassOf Container", "is container"):
        assert {name for name, _ in answer(graph, facets, question).evidence} == {
            "mug",
            "bowl",
        }
    with pytest.raises(UserError, match="No object of the task answers"):
        answer(graph, facets, "not subClassOf Container")


def test_annotated_triples_are_as_probable_as_they_say(tmp_path):
    text = (
        ":bottle :usedFor :drinking {| :confidence .01 |} . :mug :usedFor :drinking ."
    )
    graph, _ = read(tmp_path, text)
    facets = [(name, "red") for name in ("mug", "bottle")]
    assert set(answer(graph, facets, "usedFor drinking").evidence) == {("mug", "red")}


@pytest.mark.parametrize(
    ("axioms", "question"),
    [
        (":Vessel owl:disjointWith :Food .", "not subClassOf Food"),
        ("[] owl:sourceIndividual :Mug ; owl:assertionProperty :usedFor ;"
         "owl:targetIndividual :eating . :Bowl :usedFor :eating .", "not usedFor eating"),
        (f":Vessel rdfs:subClassOf [ owl:complementOf {some('usedFor', ':eating')} ] ."
         ":Bowl :usedFor :eating .", "not usedFor eating"),
    ],
    ids=["classes", "facts", "restrictions"],
)  # fmt: skip
def test_what_axioms_deny_is_denied_and_not_only_unsaid(tmp_path, axioms, question):
    rest = ":Mug rdfs:subClassOf :Vessel . :Lamp :near :Pan . :Apple rdfs:subClassOf :Food ."
    graph, _ = read(tmp_path, axioms + rest)
    facets = [(name, "red") for name in ("mug", "lamp")]
    answers = answer(graph, facets, question)
    assert answers.satisfies.tolist() == [True, True]
    assert answers.stated.tolist() == [True, False]
    with pytest.raises(UserError, match="No object of the task answers"):
        answer(graph, facets, question.removeprefix("not "))


def test_what_rests_on_imports_that_are_not_at_hand_says_so(tmp_path):
    text = "<http://x.org/o> a owl:Ontology ; owl:imports <http://x.org/other> ."
    text += ":Mug rdfs:subClassOf :Dish . :Lamp :near :Mug ."
    graph, lines = read(tmp_path, text)
    assert "http://x.org/other" in "".join(map(str, lines))
    facets = [("mug", "red"), ("lamp", "red")]
    found = answer(graph, facets, "not subClassOf Dish")
    assert found.evidence == {
        ("lamp", "red"): (
            "not stated: subClassOf Dish (imported and not at hand: http://x.org/other)",
        )
    }
    assert "not at hand" not in str(answer(graph, facets, "subClassOf Dish").evidence)


def test_of_a_relation_and_a_broader_one_the_named_one_is_asked_else_the_broader(
    tmp_path,
):
    text = ":storedIn rdfs:subPropertyOf :locatedIn . :Mug :storedIn :bedroom ."
    graph, _ = read(
        tmp_path, text + ":Lamp :locatedIn :bedroom . :Bowl :storedIn :kitchen ."
    )
    facets = [(name, "red") for name in ("mug", "lamp", "bowl")]
    for question, reading, expected in (
        ("stored in the bedroom", "storedIn bedroom", {"mug"}),
        ("something in the bedroom", "locatedIn bedroom", {"mug", "lamp"}),
        ("located in the bedroom", "locatedIn bedroom", {"mug", "lamp"}),
    ):
        found = answer(graph, facets, question)
        assert found.question == reading
        assert {name for name, _ in found.evidence} == expected
