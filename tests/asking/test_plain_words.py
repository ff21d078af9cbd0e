"""Questions in plain words: read as conditions, or refused; the list of questions is fixed."""

import csv
import re
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from knowarm.asking.answers import answer, reading, row_of
from knowarm.errors import UserError
from knowarm.experiment.names import experiment_config
from knowarm.knowledge.formats import read_graph
from knowarm.knowledge.graph.builder import graph_of
from knowarm.knowledge.graph.terms import name_key
from knowarm.world.config import facets_of

FOLDER = Path(__file__).parent / "questions"
FACETS = facets_of(experiment_config("irb120-choose-subgraph-fast").env)
PHRASES = {
    "usedFor": "for {}",
    "hasPart": "with a {}",
    "isMadeOf": "made of {}",
    "contains": "that contains {}",
    "isLocatedIn": "in the {}",
    "hasColor": "in {}",
}


def rows_of(file):
    """Return the rows of a list of questions."""
    with (FOLDER / file).open(encoding="utf-8") as lines:
        return list(csv.DictReader(lines, delimiter="\t", quoting=csv.QUOTE_NONE))


def questions():
    """Yield whether a question is held out from tuning (every third), and its row of the list."""
    for number, row in enumerate(rows_of("questions.tsv")):
        yield number % 3 == 2, row


@cache
def graph_named(name):
    file = FOLDER / f"{name}.csv"
    return read_graph(str(file) if file.is_file() else name)


def meaning(text):
    """Return the conditions of a question and what joins them, apart from order and spelling."""
    words = re.findall(
        r'"[^"]*"|[^()\s]+', text.replace("==", "=").replace("Colour", "Color")
    )
    return sorted(name_key(word) for word in words)


def outcome(row):
    """Return whether a question is read rightly, refused or read wrongly ("-": to be refused)."""
    graph = graph_named(row["graph"])
    try:
        text = reading(graph, FACETS, row["question"])
        if row["expected"] == "-":
            answer(graph, FACETS, text)
    except UserError:
        return "right" if row["expected"] == "-" else "refused"
    return "right" if meaning(text) == meaning(row["expected"]) else "wrong"


@pytest.mark.parametrize("held_out", [False, True])
def test_questions_are_read_rightly_or_refused(held_out):
    found = Counter(outcome(row) for held, row in questions() if held == held_out)
    assert found["right"] > 0.95 * found.total()
    assert found["wrong"] == 0


def test_wordings_that_the_grammar_was_not_made_for_are_read_as_often_as_when_written():
    """200 questions with names of objects, places, several sentences and words of other graphs.

    ``is``, ``leftOf`` and their kind stand for conditions that no grammar knows yet.
    """
    found = Counter(outcome(row) for row in rows_of("wordings.tsv"))
    assert found.total() == 200
    assert found["right"] >= 101
    assert found["wrong"] <= 2


@pytest.mark.parametrize(
    ("question", "message"),
    [
        ("something heavy for carrying", "'heavy' fits nothing here"),
        ("something for tea", "Nearest: contains tea; "),
        ("the red mug", "'mug' names an object"),
        ("something in turquoise", "'turquoise' fits nothing here"),
        ("hasColor turquoise", "blue"),
        ("where is something red", "only questions for an object"),
        ("I want to decorate the living room", "'living' fits nothing here"),
        (
            "something round and brown or cylindrical and red",
            "with brackets, as (hasShape round or hasColor brown) and hasColor red.",
        ),
        (
            "something red or with a lid and round",
            "'and' and 'or' can be joined in several ways",
        ),
        ("something " + "red " * 60, "allowed are 1 to 60"),
        ("x" * 60_000, "60,000 letters are not read"),
    ],
)
def test_what_is_not_understood_is_refused_in_one_line(question, message):
    with pytest.raises(UserError, match=re.escape(message)) as refusal:
        answer(graph_named("objects"), FACETS, question)
    assert "\n" not in str(refusal.value)


def test_a_negation_ends_with_its_thing():
    text = reading(graph_named("objects"), FACETS, "not the blue one, the red one")
    assert text == "not hasColor blue and hasColor red"


def test_a_value_of_two_relations_is_refused_until_one_is_said():
    graph = graph_of([("mug", "isMadeOf", "glass"), ("lamp", "hasShape", "glass")])
    with pytest.raises(UserError, match="may mean"):
        reading(graph, FACETS, "something glass")
    assert reading(graph, FACETS, "something made of glass") == "isMadeOf glass"
    assert reading(graph_named("home"), FACETS, "made by bees") == "madeBy bees"
    with pytest.raises(UserError, match="not understood"):
        reading(graph_named("home"), FACETS, "made of bees")


def test_ties_of_a_superlative_all_answer():
    found = answer(graph_named("objects"), FACETS, "the object with the most parts")
    assert {name for name, _ in found.evidence} == {"teapot", "kettle", "pot"}


def sparql(conditions, is_or):
    """Return conditions, each with its negation, in SPARQL."""
    parts = [
        f"{{ ?object :isMarked :yes . FILTER NOT EXISTS {{ ?object :{r} :{v} }} }}"
        if negated
        else f"{{ ?object :{r} :{v} }}"
        for r, v, negated in conditions
    ]
    return f"SELECT ?object WHERE {{ {(' UNION ' if is_or else ' ').join(parts)} }}"


def test_words_sparql_and_conditions_answer_alike():
    random = np.random.default_rng(0)
    objects, colours = ["mug", "lamp", "book", "vase"], ["red", "blue"]
    values = {"hasColor": colours} | {
        relation: [f"{relation.lower()}{each}" for each in "abc"]
        for relation in PHRASES
        if relation != "hasColor"
    }
    facets = [(name, colour) for name in objects for colour in colours]
    answered = 0
    for number in range(1_000):
        if number % 100 == 0:
            facts = [(o, "isMarked", "yes") for o in objects]
            facts += [
                (o, r, v)
                for o in objects
                for r in PHRASES
                if r != "hasColor"
                for v in values[r]
                if random.random() < 0.5 or o == "mug"
            ]
            graph = graph_of(facts)
        picked = random.choice(
            [*PHRASES], random.integers(1, 4), replace=False
        ).tolist()
        conditions = [
            (r, str(random.choice(values[r])), random.random() < 0.4) for r in picked
        ]
        is_or = bool(random.random() < 0.3)
        exact = [f"{'not ' * n}{r} {v}" for r, v, n in conditions]
        words = ["not " * n + PHRASES[r].format(v) for r, v, n in conditions]
        texts = {
            "exact": (" or " if is_or else " and ").join(exact),
            "words": "give me something "
            + (" or something " if is_or else " and ").join(words),
            "sparql": sparql(conditions, is_or),
        }
        answers = set()
        for text in texts.values():
            try:
                answers.add(answer(graph, facets, text).satisfies.tobytes())
            except UserError as error:
                answers.add(
                    "nobody" if "No object of the task" in str(error) else str(error)
                )
        assert len(answers) == 1, texts
        answered += answers != {"nobody"}
    assert answered > 500


def test_a_prompt_means_a_row_of_a_policy():
    rows = [
        "usedFor drinking",
        "hasColor red and isMadeOf metal",
        "isLocatedIn living room",
    ]
    assert row_of("something to drink from", rows) == rows[0]
    assert row_of("a metal thing that is red", rows) == rows[1]
    assert row_of("in the living room", rows) == rows[2]
    for prompt in ("something red", "something to drink from that is not red"):
        with pytest.raises(UserError, match="The policy knows no query"):
            row_of(prompt, rows)
