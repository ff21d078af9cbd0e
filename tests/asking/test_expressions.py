"""Questions: what answers them, with which evidence, and what a mistake is answered with."""

from collections import Counter

import numpy as np
import pytest

from knowarm.asking.answers import answer
from knowarm.errors import UserError
from knowarm.experiment.names import experiment_config
from knowarm.fence import Fence
from knowarm.knowledge.formats import read_graph, shipped_graph
from knowarm.knowledge.graph.builder import graph_of
from knowarm.knowledge.graph.edits import edited
from knowarm.knowledge.graph.terms import literal
from knowarm.knowledge.queries.queries import QueryGraph
from knowarm.knowledge.queries.sparql import SparqlQuery
from knowarm.questions import Query
from knowarm.world.config import facets_of, questions_of
from knowarm.world.objects import TARGETS
from tests.thorough import thorough

pytestmark = pytest.mark.usefixtures("unfenced")

GRAPH = graph_of(
    [
        ("mug", "usedFor", "drinking"),
        ("mug", "hasPart", "handle"),
        ("mug", "hasColor", "blue"),
        ("lamp", "usedFor", "lighting"),
        ("lamp", "hasPart", "shade"),
        ("lamp", "hasPart", "base"),
        ("watering_can", "usedFor", "watering"),
        ("watering_can", "hasPart", "handle"),
        ("watering_can", "hasPart", "spout"),
        ("drinking", "relatedTo", "tea"),
        ("tea", "isA", "hot drink"),
    ]
)
FACETS = [
    (name, c) for name in ("mug", "lamp", "watering_can") for c in ("blue", "red")
]


def names(text, graph=GRAPH):
    """Return the objects that answer, and their colours unless all of them do."""
    found = answer(graph, FACETS, text)
    assert [f in found.evidence for f in FACETS] == found.satisfies.tolist()
    colours = {
        name: [c for n, c in found.evidence if n == name] for name, _ in found.evidence
    }
    return {n + (f" {c[0]}" if len(c) == 1 else "") for n, c in colours.items()}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("usedFor drinking", {"mug"}),
        ("hasPart handle and not usedFor drinking", {"watering_can"}),
        ("not hasPart handle", {"lamp"}),
        ("not (hasPart handle and usedFor drinking)", {"lamp", "watering_can"}),
        ("usedFor drinking or usedFor lighting", {"mug", "lamp"}),
        # "and" binds tighter than "or"
        (
            "usedFor lighting or hasPart handle and hasPart spout",
            {"lamp", "watering_can"},
        ),
        ("(usedFor lighting or hasPart handle) and hasPart spout", {"watering_can"}),
        ("usedFor (relatedTo tea)", {"mug"}),
        ("usedFor (relatedTo (isA hot drink))", {"mug"}),
        ('usedFor (relatedTo (isA "hot drink"))', {"mug"}),
        ("count hasPart >= 2", {"lamp", "watering_can"}),
        ("count hasPart = 1", {"mug"}),
        ("count usedFor (relatedTo tea) = 0", {"lamp", "watering_can"}),
        # the colour that the image shows counts, not the one that the graph states
        ("usedFor drinking and not hasColor blue", {"mug red"}),
        ("hasColor red and hasPart handle", {"mug red", "watering_can red"}),
        ("SELECT ?object WHERE { ?object :hasPart :handle }", {"mug", "watering_can"}),
        (
            "SELECT ?object { ?object :hasColor :blue ; :hasPart :handle }",
            {"mug blue", "watering_can blue"},
        ),
        (
            "SELECT ?object { ?object :usedFor ?x FILTER NOT EXISTS { ?object :hasColor :blue } }",
            {"mug red", "lamp red", "watering_can red"},
        ),
        (
            "select ?object ?colour { ?object :hasColor ?colour ; :hasPart :shade }",
            {"lamp"},
        ),
        (
            'SELECT ?object ?color { ?object :hasPart :shade . BIND("red" AS ?color) }',
            {"lamp red"},
        ),
    ],
)
def test_the_graph_answers(text, expected):
    assert names(text) == expected


def test_evidence_is_what_makes_an_answer_true():
    found = answer(GRAPH, FACETS, "usedFor (relatedTo tea) and not hasColor blue")
    assert found.evidence == {
        ("mug", "red"): (
            "mug usedFor drinking",
            "drinking relatedTo tea",
            "the image shows red",
        )
    }
    counted = answer(GRAPH, FACETS, "count hasPart > 1").evidence["lamp", "blue"]
    assert counted == ("lamp hasPart base", "lamp hasPart shade", "counted: 2")
    seen = answer(GRAPH, FACETS, "hasColor red").evidence["lamp", "red"]
    assert seen == ("the image shows red",)


def test_objects_that_the_graph_does_not_describe_never_answer():
    facets = [*FACETS, ("globe", "red")]
    assert not answer(GRAPH, facets, "not usedFor drinking").satisfies[-1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("usedFor", "expected a value of usedFor, got its end"),
        ("", "has 0 words"),
        ("usedFor drinking and", "expected a relation, got its end"),
        ("usedFor drinking )", r"expected 'and' or 'or', got '\)'"),
        ("usedFor (relatedTo tea", r"expected '\)', got its end"),
        ("uzedFor drinking", "'uzed' fits nothing here"),
        ("usedFor drnking", "Did you mean 'drinking'"),
        ("count hasPart >= x", "expected a comparison such as >= 2"),
        ("count hasPart >= many", "expected a comparison such as >= 2"),
        ("usedFor tea", "No object of the task answers"),
        ("SELECT ?x WHERE { ?x :hasPart :handle }", r"must select \?object"),
        (
            "SELECT ?object ?colr { ?object :hasColor ?colr }",
            r"no more; got object, colr",
        ),
    ],
)
def test_what_cannot_be_answered_is_one_clear_line(text, message):
    with pytest.raises(UserError, match=message) as error:
        answer(GRAPH, FACETS, text)
    assert "\n" not in str(error.value)


def test_a_graph_of_other_things_is_refused():
    with pytest.raises(UserError, match="describes none of the 3 objects"):
        answer(graph_of([("planet", "orbits", "sun")]), FACETS, "orbits sun")


def test_every_condition_of_the_choose_task_has_the_answers_of_its_table():
    env = experiment_config("irb120-choose-subgraph-fast").env
    questions, facets = questions_of(env), facets_of(env)
    graph, checked = shipped_graph("objects"), Counter()
    for number, query in enumerate(questions.queries):
        is_pair = " and " in query.name
        satisfies = questions.satisfies[number]
        if satisfies.any() and not (is_pair and number % 6):
            np.testing.assert_array_equal(
                answer(graph, facets, query.name).satisfies, satisfies
            )
            checked[is_pair] += 1
    assert checked[False] > 40
    assert checked[True] > 40


def test_edits_change_answers():
    graph = edited(GRAPH, ["- mug usedFor drinking", "+ lamp usedFor drinking"])
    assert names("usedFor drinking", graph) == {"lamp"}
    assert names("usedFor drinking") == {"mug"}  # the graph itself is unchanged
    new = edited(GRAPH, ['+ lamp standsOn "the desk"'])
    assert names('standsOn "the desk"', new) == {"lamp"}


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        ("mug usedFor drinking", "must be . or - and a head"),
        ("+ mug usedFor", "must be . or - and a head"),
        ('+ mug "usedFor drinking', "must be . or - and a head"),
        (
            "- mug usedFor lighting",
            "does not hold. It states: mug hasColor blue; mug hasPart handle; mug usedFor drinking",
        ),
        ("- globe usedFor lighting", "nothing about globe"),
    ],
)
def test_edits_that_do_not_fit_are_refused(edit, message):
    with pytest.raises(UserError, match=message):
        edited(GRAPH, [edit])


@pytest.mark.parametrize(
    ("question", "message"),
    [
        (" or ".join(["usedFor drinking"] * 2000), "has 5999 words .*at most 500"),
        (f"count hasPart >= {'9' * 5000}", "a comparison such as >= 2"),
    ],
)
def test_endless_questions_are_refused(question, message):
    with pytest.raises(UserError, match=message):
        answer(GRAPH, [("mug", "red")], question)


@pytest.mark.parametrize("edit", ["+ mug likes tea", "+ http://a/mug likes tea"])
def test_an_edit_of_several_things_is_refused(edit):
    graph = graph_of(
        [("http://a/mug", "http://a/likes", "x"), ("http://b/mug", "b:likes", "y")]
    )
    with pytest.raises(UserError, match=r"'(mug|likes)' names 2 (entities|relations)"):
        edited(graph, [edit])


def test_the_colour_that_is_shown_counts_even_if_only_the_graph_knows_it():
    graph = graph_of([*GRAPH, ("mug", "hasColor", "green")])
    with pytest.raises(UserError, match="No object of the task answers"):
        answer(graph, FACETS, "hasColor green")
    assert names("hasPart handle and not hasColor green", graph) == {
        "mug",
        "watering_can",
    }


@pytest.mark.parametrize(
    "text", ["(" * 2000 + "usedFor tea" + ")" * 2000, "not " * 2000 + "tea"]
)
def test_a_question_nests_no_deeper_than_it_can_be_read(text):
    with pytest.raises(
        UserError, match="2000 brackets and negations; at most 500 and 50"
    ):
        answer(GRAPH, FACETS, text)
    for deep in (
        "(" * 50 + "usedFor drinking" + ")" * 50,
        "not " * 50 + "usedFor drinking",
    ):
        assert names(deep) == {"mug"}


def test_a_string_answers_as_the_name_of_the_same_text_does():
    graph = graph_of(
        [("mug", "usedFor", "drinking"), ("lamp", "usedFor", literal("drinking"))]
    )
    assert names("usedFor drinking", graph) == {"mug", "lamp"}
    assert names("usedFor drinking", graph_of([*graph, ("mug", "price", literal("5"))])) == {
        "mug", "lamp",
    }  # fmt: skip
    only = graph_of([("lamp", "usedFor", literal("drinking", language="en"))])
    assert names("usedFor drinking", only) == {"lamp"}
    table = QueryGraph(graph, FACETS[:4])
    assert table.answers([Query.of(("usedFor", "drinking"))]).all()


def test_relations_of_one_last_part_are_told_apart():
    a, b = "http://a.org/", "http://b.org/"
    graph = graph_of(
        [(a + "mug", a + "hasPart", a + "x"), (a + "lamp", b + "hasPart", a + "x")]
    )
    with pytest.raises(
        UserError, match=r"'hasPart' names 2 relations.*http://a.org/hasPart"
    ):
        answer(graph, FACETS, "hasPart x")
    assert names("http://b.org/hasPart x", graph) == {"lamp"}
    assert names(f"{a}hasPart x or {b}hasPart x", graph) == {"mug", "lamp"}


def test_labels_name_relations():
    e = "http://e.org/"
    graph = graph_of(
        [("mug", e + "P1", e + "Q2")], labels={e + "P1": "usedFor", e + "Q2": "tea"}
    )
    assert names("usedFor tea", graph) == {"mug"}


def random_question(rng, depth, target="?object"):
    """Return a random question in words, and as a condition of SPARQL."""
    kind = rng.choice(
        ["fact", "colour", "not", "and", "or", "chain", "count"][: 7 if depth else 2]
    )
    values = {
        "usedFor": ["drinking", "lighting", "watering"],
        "hasPart": ["handle", "base", "mug"],
    }
    relation = str(rng.choice(list(values)))
    if kind == "fact":
        value = rng.choice(values[relation])
        return f"{relation} {value}", f"EXISTS {{ {target} :{relation} :{value} }}"
    if kind == "colour":
        value = rng.choice(["blue", "red"])
        return f"hasColor {value}", f"EXISTS {{ {target} :hasColor :{value} }}"
    if kind == "not":
        words, sparql = random_question(rng, depth - 1, target)
        return f"not ({words})", f"!({sparql})"
    if kind in ("and", "or"):
        parts = [random_question(rng, depth - 1, target) for _ in range(2)]
        sign = {"and": "&&", "or": "||"}[kind]
        return (
            f"(({parts[0][0]}) {kind} ({parts[1][0]}))",
            f"({parts[0][1]} {sign} {parts[1][1]})",
        )
    inner = f"?x{depth}"
    words, sparql = random_question(rng, depth - 1, inner)
    body = f"{target} :{relation} {inner} FILTER({sparql})"
    if kind == "chain":
        return f"{relation} ({words})", f"EXISTS {{ {body} }}"
    other = f"?y{depth}"
    two = f"{body} {target} :{relation} {other} FILTER({sparql.replace(inner, other)})"
    return (
        f"count {relation} ({words}) >= 2",
        f"EXISTS {{ {two} FILTER({inner} != {other}) }}",
    )


def test_words_and_sparql_give_the_same_answers_to_random_questions_with_colours():
    rng = np.random.default_rng(0)
    always = ("lamp", "isA", "anchor")  # so that no question is without an answer
    graph = graph_of(
        [*GRAPH, ("lamp", "hasPart", "mug"), ("lamp", "usedFor", "drinking"), always]
    )
    answered = 0
    count = thorough(100, 300)
    for _ in range(count):
        words, condition = random_question(rng, 3)
        objects = "VALUES ?object { :mug :lamp :watering_can }"
        either = f"{condition} || EXISTS {{ ?object :isA :anchor }}"
        one = answer(graph, FACETS, f"{words} or isA anchor").evidence
        other = answer(
            graph, FACETS, f"SELECT ?object {{ {objects} FILTER({either}) }}"
        ).evidence
        assert set(one) == set(other), words
        answered += any(name != "lamp" for name, _ in one)
    assert answered > count / 3


KITCHEN = """@prefix : <http://x#> . @prefix o: <http://other#> .
:mug :usedFor :drinking ; :near o:stove . :jar :usedFor :storing ."""


@pytest.mark.parametrize(
    ("question", "expected"),
    [
        ("SELECT ?object { ?object :usedFor :drinking }", {"mug"}),
        ("SELECT ?object { ?object :near o:stove }", {"mug"}),
        ("SELECT ?object { ?object :usedFor :storing ; :hasColor :blue }", {"jar"}),
        ("SELECT ?object { ?object :hasColor <urn:knowarm:red> }", {"mug", "jar"}),
        (
            "PREFIX : <urn:knowarm:> SELECT ?object { ?object :hasColor :blue }",
            {"mug", "jar"},
        ),
        ("usedFor drinking", {"mug"}),
    ],
)
def test_sparql_knows_the_prefixes_of_the_file(tmp_path, question, expected):
    path = tmp_path / "kitchen.ttl"
    path.write_text(KITCHEN)
    facets = [(name, hue) for name in ("mug", "jar") for hue in ("red", "blue")]
    found = answer(read_graph(path), facets, question).evidence
    assert {name for name, _ in found} == expected
    hues = {hue for _, hue in found}
    assert hues == {"red", "blue"} - {
        other for hue, other in (("red", "blue"), ("blue", "red")) if hue in question
    }


@pytest.mark.parametrize(
    ("question", "message"),
    [
        (
            "SELECT ?object { ?object <urn:knowarm:usedFor> :drinking }",
            r"not hold <urn:knowarm:usedFor> \(but <http://x#usedFor>\)\. Ask another",
        ),
        ("SELECT ?object { ?object :usedFor :drinkng }", "hold <http://x#drinkng>"),
        (
            "SELECT ?object { ?object k:usedFor :drinking }",
            "nothing declares the prefix k: Known: :, .*o:",
        ),
        (
            "SELECT ?object { ?object :usedFor :drinking, :storing }",
            r"storing }'\. Ask another",
        ),
    ],
)
def test_sparql_without_an_answer_names_what_the_graph_lacks(
    tmp_path, question, message
):
    path = tmp_path / "kitchen.ttl"
    path.write_text(KITCHEN)
    with pytest.raises(UserError, match=message):
        answer(read_graph(path), [("mug", "red"), ("jar", "red")], question)


def test_sparql_that_reads_no_colours_runs_once_with_the_same_answers(monkeypatch):
    graph = shipped_graph("objects")
    names = set(TARGETS) & set(graph.entities)
    facets = [(name, hue) for name in sorted(names) for hue in ("red", "blue")]
    patterns = (
        "?object :usedFor :drinking",
        "?object :usedFor/:relatedTo ?x",
        "?object :hasPart ?x . ?y :hasPart ?x FILTER(?y != ?object)",
        "?object :hasPart :handle MINUS { ?object :usedFor :drinking }",
        "?object :isMadeOf ?x FILTER NOT EXISTS { ?z :isMadeOf ?x ; :usedFor :cooking }",
        "{ ?object :contains ?x } UNION { ?object :usedFor :lighting }",
        "SELECT ?object { ?object :hasPart ?x } GROUP BY ?object HAVING (COUNT(?x) > 2)",
        "SELECT ?object { ?object :hasPart ?x } ORDER BY ?object LIMIT 2",
        "?object :hasColor :red ; :usedFor :drinking",
        "?object ?p :red",
    )
    runs = Counter()
    run = SparqlQuery.run
    monkeypatch.setattr(Fence, "is_inside", True)  # to count in this process

    def counted(query, about=None):
        runs[query.query] += 1
        return run(query, about)

    monkeypatch.setattr(SparqlQuery, "run", counted)
    for pattern in patterns:
        query = pattern if "SELECT" in pattern else f"SELECT ?object {{ {pattern} }}"
        found = answer(graph, facets, query).evidence
        once = runs.pop(query)
        with monkeypatch.context() as context:
            context.setattr(SparqlQuery, "may_read", lambda query, local: True)
            assert answer(graph, facets, query).evidence == found
        assert runs.pop(query) >= len(facets) > 40
        assert (once == 1) == (":red" not in pattern), pattern
