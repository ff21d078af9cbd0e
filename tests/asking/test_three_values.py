"""Stated, denied, not stated: what each of them answers, and how surely."""

import numpy as np
import pytest

from knowarm.asking.answers import answer, reading
from knowarm.errors import UserError
from knowarm.knowledge.formats import shipped_graph
from knowarm.knowledge.graph.builder import graph_of
from knowarm.knowledge.graph.denials import denial, negative_words, stance
from knowarm.knowledge.graph.homonyms import find_object
from knowarm.knowledge.graph.terms import RDF_TYPE
from knowarm.knowledge.queries.queries import QueryGraph
from knowarm.questions import Query
from tests.thorough import thorough

GRAPHS = thorough(300, 1_000)
"""Random graphs of a test."""
OBJECTS = ("mug", "bowl", "lamp")
FACETS = [(name, colour) for name in OBJECTS for colour in ("blue", "red")]


def names(graph, text, facets=FACETS):
    """Return the objects that answer, none without."""
    return {name for name, _ in facets_that_answer(graph, text, facets)}


def facets_that_answer(graph, text, facets=FACETS):
    try:
        return set(answer(graph, facets, text).evidence)
    except UserError as error:
        if "No object of the task answers" not in str(error):
            raise
        return set()


@pytest.mark.parametrize(
    ("affirming", "denying"),
    [
        ("usedFor", "notUsedFor"),
        ("usedFor", "isNotUsedFor"),
        ("usedFor", "cannot_be_used_for"),
        ("usedFor", "NOT_USED_FOR"),
        ("usedFor", "unusedFor"),
        ("usedFor", "usedForNot"),
        ("usedFor", "!usedFor"),
        ("usedFor", "~usedFor"),
        ("usedFor", "¬usedFor"),
        ("usedFor", "neg_usedFor"),
        ("usedFor", "notToBeUsedFor"),
        ("usedFor", "doNotUseFor"),
        ("hasPart", "lacks"),
        ("hasPart", "without"),
        ("hasPart", "hasNo"),
        ("hasPart", "doesNotHave"),
        ("HasA", "isMissing"),
        ("ableTo", "unableTo"),
        ("usedFor", "not_used_for"),
        ("isUsedFor", "never used for"),
        ("http://x.org/k#usedFor", "http://x.org/k#notUsedFor"),
        ("http://x.org/usedFor", "http://x.org/not/usedFor"),
        ("http://x.org/k#usedFor", "http://x.org/negative#used_for"),
        ("urn:usedFor", "urn:Not:usedFor"),
        ("usedFor", "denied:isUsedFor"),
        ("contains", "doesNotContain"),
        ("contains", "doesn't contain"),
        ("locatedIn", "neverLocatedIn"),
        ("locatedIn", "noLongerLocatedIn"),
        ("safeFor", "unsafeFor"),
        ("suitableFor", "unsuitable-for"),
        ("compatibleWith", "incompatibleWith"),
        ("HasProperty", "NotHasProperty"),
        ("CapableOf", "NotCapableOf"),
        ("canHold", "cannotHold"),
        ("hasPart", "hasNoPart"),
        ("hasPart", "lacksPart"),
        ("edible", "nonEdible"),
        ("isA", "isNotA"),
    ],
)
def test_a_relation_that_denies_never_answers_what_it_denies(affirming, denying):
    graph = graph_of(
        [
            ("mug", denying, "water"),
            ("lamp", affirming, "oil"),
            ("bowl", "weighs", "much"),
        ]
    )
    asked = f'"{affirming}" water'
    assert names(graph, asked) == set()
    assert names(graph, f"not {asked}") == {"mug", "lamp", "bowl"}
    assert names(graph, f'"{denying}" water') == {"mug"}
    found = answer(graph, FACETS, f"not {asked}")
    assert found.stated.any()
    assert {FACETS[i][0] for i in np.flatnonzero(found.stated)} == {"mug"}
    assert found.evidence["bowl", "red"][0].startswith("not stated: ")
    with pytest.raises(UserError, match="What speaks against it: mug "):
        answer(graph, FACETS, asked)


@pytest.mark.parametrize(
    "name",
    ["uniqueTo", "under", "unitOf", "unlocks", "understands", "installedIn", "includes",
     "notedFor", "inside", "until", "unionOf", "disposedIn", "noseOf", "interacts"],
)  # fmt: skip
def test_names_that_only_look_like_a_negation_deny_nothing(name):
    assert not stance(name).denies
    assert not negative_words([name.lower()])


@pytest.mark.parametrize("space", ["http://x.org/no/", "http://x.org/knot#", "x:"])
def test_namespaces_that_only_look_like_a_negation_deny_nothing(space):
    assert not stance(f"{space}usedFor").denies


def test_a_short_name_is_no_relation_that_its_namespace_denies():
    graph = graph_of([("mug", "http://x.org/not/usedFor", "water")])
    assert names(graph, "usedFor water") == set()
    assert names(graph, "something for water") == set()
    assert "mug" in names(graph, "not usedFor water")


@pytest.mark.parametrize(
    "denying", ["notSuitableFor", "unsuitableFor", "notGoodFor", "hasNoUseFor", "notUsableFor"]
)  # fmt: skip
def test_a_synonym_of_what_is_denied_does_not_block_what_is_stated(denying):
    """The plain question is about the relation by which the graph states something."""
    triples = [("mug", denying, "eating"), ("bowl", "usedFor", "eating")]
    graph = graph_of(triples)
    assert names(graph, "something for eating") == {"bowl"}
    assert "mug" in names(graph, "something that is not for eating")


@pytest.mark.parametrize(
    ("denying", "question", "read"),
    [
        ("notUsedFor", "something for water", "usedFor water"),
        ("isNotUsedFor", "something for water", "isUsedFor water"),
        ("lacks", "something with water", "hasPart water"),
        ("doesNotContain", "something that contains water", "contain water"),
    ],
)
def test_what_is_denied_alone_is_asked_by_a_name_without_the_negation(
    denying, question, read
):
    graph = graph_of([("mug", denying, "water"), ("bowl", "weighs", "much")])
    with pytest.raises(
        UserError, match=f"No object .* '{read}'.*against it: mug {denying} water"
    ):
        answer(graph, FACETS, question)


def test_a_denial_is_named_by_what_it_denies():
    assert denial("usedFor") == "notUsedFor"
    assert denial("http://x.org/k#usedFor") == "http://x.org/k#notUsedFor"
    for relation in ("usedFor", "http://x.org/k#usedFor", RDF_TYPE):
        one = stance(relation)
        other = stance(denial(relation))
        assert one.subject == other.subject
        assert other.denies


def test_a_relation_that_only_its_denial_names_can_be_asked():
    graph = graph_of([("mug", "notUsedFor", "eating"), ("bowl", "hasPart", "rim")])
    assert names(graph, "usedFor eating") == set()
    assert names(graph, "not usedFor eating") == {"mug", "bowl"}


def test_what_a_graph_states_and_denies_answers_neither():
    graph = graph_of(
        [
            ("mug", "usedFor", "tea"),
            ("mug", "notUsedFor", "tea"),
            ("bowl", "usedFor", "tea"),
        ]
    )
    assert names(graph, "usedFor tea") == {"bowl"}
    assert names(graph, "not usedFor tea") == set()
    table = QueryGraph(graph, FACETS[:4])
    row = table.answers([Query.of(("usedFor", "tea"))])[0]
    assert row.tolist() == [False, False, True, True]


@pytest.mark.parametrize(
    ("graph", "question", "hint"),
    [
        ("household", "isA food", "contains food"),
        ("objects", "isA shape", "hasShape"),
    ],
)
def test_a_condition_stays_one_where_nobody_answers(graph, question, hint):
    shipped = shipped_graph(graph)
    objects = [
        name
        for name in ("mug", "pan", "bowl")
        if find_object(shipped, name) is not None
    ]
    facets = [(name, "red") for name in objects]
    extended = graph_of([*shipped, ("thing", *question.split(" "))])
    assert reading(extended, facets, question) == question
    with pytest.raises(UserError, match="No object of the task answers") as error:
        answer(extended, facets, question)
    assert hint in str(error.value)
    assert names(extended, f"not {question}", facets) == set(objects)


RELATIONS = (
    "usedFor",
    "notUsedFor",
    "contains",
    "doesNotContain",
    "isA",
    "isNotA",
    "hasPart",
)
VALUES = ("tea", "oil", "mug", "lamp")


def random_graph(rng):
    """Return a graph of random facts and denials, half of them doubtful."""
    triples = {("mug", "isA", "thing"), ("bowl", "isA", "thing")}
    for _ in range(rng.integers(3, 12)):
        head = str(rng.choice([*OBJECTS, "tea"]))
        relation = str(rng.choice(RELATIONS))
        triples.add((head, relation, str(rng.choice(VALUES))))
    confidence = {}
    for triple in sorted(triples):
        if rng.random() < 0.5:
            confidence[triple] = float(rng.choice([0, 0.01, 0.4, 0.5, 0.9]))
    return graph_of(triples, confidence=confidence)


def random_question(rng, graph, depth):
    """Return a random question in conditions."""
    kind = rng.choice(["fact", "colour", "not", "and", "or", "chain", "count"])
    if depth == 0 or kind == "fact":
        rows = list(graph)
        _, relation, value = rows[rng.integers(len(rows))]
        return f"{relation} {value}"
    if kind == "colour":
        return f"hasColor {rng.choice(['blue', 'red'])}"
    inner = random_question(rng, graph, depth - 1)
    relation = str(rng.choice(graph.relations_used))
    if kind == "not":
        return f"not ({inner})"
    if kind == "chain":
        return f"{relation} ({inner})"
    if kind == "count":
        return f"count {relation} ({inner}) {rng.choice(['>=', '=', '<'])} 1"
    return f"({inner}) {kind} ({random_question(rng, graph, depth - 1)})"


@pytest.fixture
def no_hints(monkeypatch):
    """Let questions without an answer end without the nearest ones, a quarter of the time."""
    monkeypatch.setattr(
        "knowarm.asking.answers._Answering.no_answer",
        lambda answering, answers: UserError("No object of the task answers"),
    )


@pytest.mark.usefixtures("no_hints")
def test_no_object_answers_a_question_and_its_negation():
    rng = np.random.default_rng(7)
    both = 0
    for _ in range(GRAPHS):
        graph = random_graph(rng)
        question = random_question(rng, graph, 2)
        negation = f"not ({question})"
        positive = facets_that_answer(graph, question)
        negative = facets_that_answer(graph, negation)
        assert positive.isdisjoint(negative), (list(graph), question)
        both += bool(positive and negative)
    assert both > GRAPHS / 4


@pytest.mark.usefixtures("no_hints")
def test_a_relation_renamed_to_its_negation_never_answers_the_positive_question():
    rng = np.random.default_rng(8)
    affirmed = {"usedFor": "notUsedFor", "contains": "doesNotContain", "isA": "isNotA"}
    answered = 0
    for _ in range(GRAPHS):
        graph = random_graph(rng)
        relation = str(rng.choice(sorted(affirmed)))
        positive = [(h, r, t) for h, r, t in graph if r == relation]
        if not positive:
            continue
        value = positive[0][2]
        renamed = []
        for head, name, tail in graph:
            if name != affirmed[relation]:
                if name == relation:
                    name = affirmed[relation]
                renamed.append((head, name, tail))
        question = f"{relation} {value}"
        answered += bool(names(graph, question))
        assert names(graph_of(renamed), question) == set()
    assert answered > GRAPHS / 5


def test_confidence_decides_as_in_an_evaluation():
    """A fact that is less probable than not is not stated; several together may be."""
    triples = {
        ("mug", "usedFor", "tea"): 1.0,
        ("bowl", "usedFor", "tea"): 0.01,
        ("lamp", "usedFor", "tea"): 0.0,
        ("bowl", "contains", "oil"): 0.7,
        ("lamp", "contains", "oil"): 0.5,
    }
    doubtful = {triple: p for triple, p in triples.items() if p < 1}
    graph = graph_of(triples, confidence=doubtful)
    assert names(graph, "usedFor tea") == {"mug"}
    assert names(graph, "not usedFor tea") == {"bowl", "lamp"}
    assert names(graph, "contains oil") == {"bowl", "lamp"}
    assert names(graph, "not contains oil") == {"mug"}
    found = answer(graph, FACETS, "contains oil")
    assert found.evidence["bowl", "red"] == ("bowl contains oil (0.7)",)
    assert found.degrees.tolist() == [0, 0, 0.7, 0.7, 0.5, 0.5]
    table = QueryGraph(graph, FACETS)
    for question in (("usedFor", "tea"), ("contains", "oil")):
        query = Query.of(question)
        asked = answer(graph, FACETS, query.name).satisfies
        np.testing.assert_array_equal(table.answers([query])[0], asked)


GRAPH = graph_of(
    [
        ("mug", "isA", "vessel"),
        ("bowl", "isA", "vessel"),
        ("lamp", "isNotA", "vessel"),
        ("lamp", "usedFor", "light"),
    ]
)


@pytest.mark.parametrize(
    ("question", "expected"),
    [
        ("is mug", {"mug"}),
        ("is Mugs", {"mug"}),
        ("is vessel", {"mug", "bowl"}),
        ("is mug or is lamp", {"mug", "lamp"}),
        ("not is mug", {"bowl", "lamp"}),
        ("is vessel and not is mug", {"bowl"}),
        ("not is vessel", {"lamp"}),
    ],
)
def test_an_object_answers_to_its_name_and_class(question, expected):
    assert names(GRAPH, question) == expected


def test_an_object_that_the_graph_does_not_describe_answers_to_its_name_alone():
    facets = [*FACETS, ("globe", "red"), ("globe", "blue")]
    assert names(GRAPH, "is globe and hasColor red", facets) == {"globe"}
    assert names(GRAPH, "not is vessel", facets) == {"lamp"}
    with pytest.raises(UserError, match="Unknown object or class 'planet'"):
        answer(GRAPH, facets, "is planet")


SCENE = {
    ("mug", "blue"): (0.1, 0.5),
    ("bowl", "red"): (0.4, 0.8),
    ("lamp", "blue"): (0.7, 0.3),
}


@pytest.mark.parametrize(
    ("question", "expected"),
    [
        ("leftOf (is lamp)", {"mug", "bowl"}),
        ("rightOf (is mug)", {"bowl", "lamp"}),
        ("leftOf (is vessel) and is mug", {"mug"}),
        ("behind (is bowl)", {"mug", "lamp"}),
        ("inFrontOf (is lamp)", {"mug", "bowl"}),
        ("not leftOf (is lamp)", {"lamp"}),
        ("leftmost", {"mug"}),
        ("rightmost and is vessel", {"bowl"}),
        ("frontmost", {"bowl"}),
        ("hindmost", {"lamp"}),
        ("nearest (is mug)", {"bowl"}),
        ("nearest (is vessel)", {"lamp"}),
        ("farthest (is mug) and hasColor red", {"bowl"}),
        ("nearest (is lamp) and not is bowl", {"mug"}),
        ("leftOf (is lamp and hasColor blue) or is lamp", {"mug", "bowl", "lamp"}),
        ("leftOf (is mug)", set()),
    ],
)
def test_places_in_the_image_decide(question, expected):
    found = answer(GRAPH, FACETS, question)
    assert found.has_places
    assert {name for name, _ in found.within(SCENE).evidence} == expected


def test_without_a_scene_all_that_may_answer_do():
    assert names(GRAPH, "leftOf (is lamp) and is vessel") == {"mug", "bowl"}
    assert names(GRAPH, "not leftmost") == set(OBJECTS)


def test_what_answers_in_the_graph_is_named_only_if_no_object_stands_for_it():
    graph = graph_of(
        [
            ("mug", "usedFor", "tea"),
            ("robe", "madeOf", "silk"),
            ("mug_1", "hasColor", "red"),
            ("mug_1", "madeOf", "clay"),
        ]
    )
    with pytest.raises(
        UserError, match=r"it is true of robe: no object stands for that"
    ):
        answer(graph, FACETS, "madeOf silk")
    with pytest.raises(UserError) as error:  # it stands for a mug, in another colour
        answer(graph, [("mug", "blue")], "madeOf clay and hasColor red")
    assert "no object stands" not in str(error.value)
    with pytest.raises(UserError) as error:
        answer(graph, FACETS, "SELECT ?object { ?object :madeOf :silk }")
    assert "no object stands" not in str(error.value)
