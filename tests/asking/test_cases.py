"""Inputs that failed in reviews, each with its right outcome, through the doors of a user."""

from pathlib import Path

import pytest

from knowarm.asking.answers import answer, reading
from knowarm.cli.main import main
from knowarm.errors import UserError
from knowarm.experiment.names import experiment_config
from knowarm.knowledge import read_graph
from knowarm.knowledge.graph.terms import local_name
from knowarm.world.config import facets_of

pytestmark = pytest.mark.filterwarnings("ignore::knowarm.errors.DataWarning")
FACETS = facets_of(experiment_config("irb120-choose-subgraph-fast").env)
CASES = Path(__file__).parent / "cases"


def case(name):
    """Return the path of a case."""
    return CASES / name


def names(graph, question):
    """Return the objects that answer, none without."""
    try:
        return {name for name, _ in answer(graph, FACETS, question).evidence}
    except UserError as error:
        if "No object of the task answers" not in str(error):
            raise
        return set()


ANSWERS = [
    ("01-negative-relation.csv", "usedFor eating", set()),
    ("01-negative-relation.csv", "usedFor drinking", {"bowl"}),
    ("01-negative-relation.csv", "contains water", set()),
    ("01-negative-relation.csv", "unsafeFor children", {"bottle"}),
    ("01-negative-relation.csv", "unsafe for children", {"bottle"}),
    ("01-negative-relation.csv", "safeFor adults", {"vase"}),
    ("01-negative-relation.csv", "canHold soup", {"pot"}),
    ("01-negative-relation.csv", "avoid heat", {"bucket"}),
    ("01-negative-relation.csv", "preferredFor heat", {"bell"}),
    ("02-subclass-of-subclass.ttl", "a container", {"mug", "bowl"}),
    ("03-homonym.ttl", "a tool", {"brush"}),
    ("03-homonym.ttl", "something that is an action", set()),
    ("05-instances.ttl", "on table", {"mug", "bowl"}),
    ("05-instances.ttl", "on shelf", {"mug"}),
    ("06-instance-names.csv", "on table", {"mug"}),
    ("06-instance-names.csv", "on shelf", {"bowl", "book"}),
    ("08-excel-sep-line.csv", "usedFor Trinken", {"mug"}),
    ("09-neo4j-apoc-lines.json", "USED_FOR drinking", {"mug"}),
    ("10-neo4j-apoc.csv", "USED_FOR eating", {"bowl"}),
    ("11-conceptnet-api.json", "UsedFor drinking", {"mug"}),
    ("11-conceptnet-api.json", "something for eating", {"bowl"}),
    ("12-virtualhome-like.json", "ON table", {"mug", "bowl"}),
    ("14-inflections-of-one-value.tsv", "something to drink from", {"bottle", "kettle"}),
    ("15-hasAbility.csv", "something breakable", {"mug"}),
    ("16-confidence-in-ask.csv", "usedFor drinking", {"mug"}),
    ("individuals.ttl", "a vessel", {"mug", "bowl"}),
    ("individuals.ttl", "locatedIn kitchen", {"mug", "bowl"}),
    ("individuals.ttl", "something stored in the bedroom", {"lamp"}),
    ("lab.ttl", "a container", {"mug", "wine_glass", "kettle"}),
    ("lab.ttl", "it may provoke scalding", {"mug", "kettle"}),
    ("lab.ttl", "a drinking vessel", {"mug", "wine_glass"}),
    ("lab-class-and-individual.ttl", "a drinking vessel", {"mug", "wine_glass"}),
    ("lab-class-and-individual.ttl", "something that can cause scalding", {"mug", "kettle"}),
    ("relation-with-space.csv", '"used for" drinking', {"mug", "wine_glass"}),
    ("relation-with-space.csv", "used for boiling", {"kettle"}),
    ("relation-with-space.csv", "something stored on the desk", {"lamp"}),
]  # fmt: skip


@pytest.mark.parametrize(("name", "question", "expected"), ANSWERS)
def test_what_answers_is_what_the_file_states(name, question, expected):
    assert names(read_graph(case(name)), question) == expected


def test_not_is_true_of_what_is_denied_and_of_nothing_below_a_class():
    denied = read_graph(case("01-negative-relation.csv"))
    found = answer(denied, FACETS, "not usedFor eating")
    assert {FACETS[i][0] for i in found.stated.nonzero()[0]} == {"mug"}
    with pytest.raises(UserError, match="speaks against it: mug notUsedFor eating"):
        answer(denied, FACETS, "usedFor eating")
    with pytest.raises(UserError, match="is not understood"):
        reading(denied, FACETS, "something for children")
    classes = read_graph(case("02-subclass-of-subclass.ttl"))
    assert names(classes, "something that is not a container").isdisjoint(
        {"mug", "bowl"}
    )
    assert "book" in names(classes, "something that is not a container")


@pytest.mark.parametrize(
    ("name", "triples"),
    [
        ("angles.txt", {("mug", "usedFor", "drinking"), ("bottle", "contains", "water")}),
        ("brackets.txt", {("mug", "usedFor", "drinking"), ("bottle", "contains", "water")}),
        ("bullets.txt", {("mug", "usedFor", "drinking"), ("bottle", "contains", "water")}),
        ("lists.jsonl", {("mug", "usedFor", "drinking"), ("bottle", "contains", "water")}),
        ("markdown-table.txt", {("mug", "usedFor", "drinking"), ("bottle", "contains", "water")}),
        ("objects.jsonl", {("mug", "usedFor", "drinking"), ("bottle", "contains", "water")}),
    ],
)  # fmt: skip
def test_triples_as_language_models_write_them(name, triples):
    assert set(read_graph(case(name))) == triples


def test_a_wide_table_is_no_table_of_triples():
    with pytest.raises(UserError, match="affordance"):
        read_graph(case("04-wide-table-no-warning.csv"))


def test_turtle_that_begins_with_brackets():
    ((_, relation, tail),) = read_graph(case("07-turtle-begins-with-brackets.ttl"))
    assert (local_name(relation), local_name(tail)) == ("usedFor", "drinking")


def test_a_relative_base():
    ((head, _, _),) = read_graph(case("13-relative-xml-base.owl"))
    assert head.endswith("test_kitchen#mug")


def test_terms_of_obo_are_shown_and_asked(capsys):
    path = case("terms.obo")
    shown = ["knowledge", "show", "--graph", str(path), "--objects", "mug"]
    shown += ["--detail", "partial"]
    assert main(shown) == 0
    assert "cup" in capsys.readouterr().out
    assert names(read_graph(path), "used_for drinking") == {"mug"}


QUESTIONS = [
    ("the mug", "is mug"),
    ("a red mug", "hasColor red and is mug"),
    ("the mug behind the bottle", "is mug and behind (is bottle)"),
    ("put the mug on the tray", ""),
    ("bring me the second mug from the left", ""),
    ("anything fragile", ""),
    ("I am thirsty", ""),
    ("something I can drink coffee from", "usedFor drinking"),
    ("the thing you would use to water plants", "usedFor watering"),
]


@pytest.mark.parametrize(("question", "expected"), QUESTIONS)
def test_questions_of_the_field_study(question, expected):
    """Those without a condition are refused, and no colour is offered for "fragile"."""
    graph = read_graph("objects")
    if expected:
        words = sorted(reading(graph, FACETS, question).split())
        assert words == sorted(expected.split())
        return
    with pytest.raises(UserError, match="is not understood") as refused:
        reading(graph, FACETS, question)
    assert "hasColor orange" not in str(refused.value)


def test_a_mug_by_its_class_is_the_mug_by_its_name():
    assert names(read_graph("objects"), "isA mug and hasColor red") in (set(), {"mug"})
