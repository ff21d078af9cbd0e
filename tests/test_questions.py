"""Question tables: what they accept, the distractor rule, and what their errors say."""

from dataclasses import replace

import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.questions import Condition, Query, QuestionTable, with_distractors

FACETS = (("mug", "red"), ("mug", "blue"), ("jar", "red"), ("can", "blue"))
DRINKING, RED = Query.of(("usedFor", "drinking")), Query.of(("hasColor", "red"))


@pytest.fixture
def table() -> QuestionTable:
    satisfies = np.array(
        [[name == "mug" for name, _ in FACETS], [c == "red" for _, c in FACETS]]
    )
    return QuestionTable(
        queries=(DRINKING, RED),
        facets=FACETS,
        satisfies=satisfies,
        askable=satisfies,
        related=np.ones((4, 4), dtype=np.bool_),
        shown=np.ones(4, dtype=np.bool_),
    )


def test_a_query_has_a_readable_name() -> None:
    both = Query((*DRINKING.conditions, *RED.conditions))
    assert both.name == str(both) == "usedFor drinking and hasColor red"
    assert both == Query.of(("usedFor", "drinking"), ("hasColor", "red"))
    assert [condition.is_seen for condition in both.conditions] == [False, True]
    assert isinstance(both.conditions[0], Condition)


def test_distractors_are_other_objects_that_do_not_satisfy_the_query(
    table: QuestionTable,
) -> None:
    beside = table.distractors(np.array([0, 1]), np.array([0, 0]))
    assert beside.tolist() == [[False, False, True, True], [False, False, False, True]]


def test_distractors_are_shown_and_related(table: QuestionTable) -> None:
    related = table.related.copy()
    related[0, 2] = related[2, 0] = False
    shown = np.array([True, True, True, False])
    few = with_distractors(
        table.askable, table.satisfies, related, shown, table.objects, 2
    )
    assert few.tolist() == [[False, True, False, False], [False, False, True, False]]


def test_enough_distractors_are_counted_as_one_by_one() -> None:
    """Equal to the definition, where objects lie in no order and some are never shown."""
    rng = np.random.default_rng(0)
    outcomes = set[bool]()
    for objects_at_most, count in ((3, 2), (40, 4), (150, 30), (150, 1)):
        objects = rng.integers(objects_at_most, size=200)
        satisfies = rng.random((9, 200)) < 0.4
        related = rng.random((200, 200)) < 0.12
        related |= related.T
        shown = rng.random(200) < 0.8
        allowed = satisfies & shown
        enough = with_distractors(allowed, satisfies, related, shown, objects, count)
        expected = np.zeros_like(allowed)
        for query, target in np.argwhere(allowed):
            beside = shown & ~satisfies[query] & related[target]
            others = set(objects[beside].tolist()) - {objects[target]}
            expected[query, target] = len(others) >= count - 1
        assert (enough == expected).all()
        outcomes.update(enough[allowed].tolist())
    assert outcomes == {True, False}


def test_one_asymmetric_pair_among_many_is_named() -> None:
    facets = tuple((f"o{number}", "red") for number in range(700))
    satisfies = np.arange(700)[None] % 2 == 0
    related = np.ones((700, 700), dtype=np.bool_)
    arguments = {
        "queries": (DRINKING,),
        "facets": facets,
        "satisfies": satisfies,
        "askable": satisfies,
        "shown": np.ones(700, dtype=np.bool_),
    }
    QuestionTable(related=related, **arguments)
    for a, b in ((3, 650), (650, 3), (299, 300), (698, 699)):
        wrong = related.copy()
        wrong[a, b] = False
        with pytest.raises(UserError, match="must be symmetric") as error:
            QuestionTable(related=wrong, **arguments)
        assert f"red o{min(a, b)} and red o{max(a, b)} are" in str(error.value)


def test_errors_name_what_to_change(table: QuestionTable) -> None:
    for change, message in (
        ({"queries": ()}, "queries is empty"),
        ({"queries": (RED, RED)}, "contains 'hasColor red' twice"),
        ({"facets": FACETS[:1] * 4}, "facets contains .*'mug', 'red'.* twice"),
        ({"shown": np.ones(3, dtype=np.bool_)}, "shape"),
        (
            {"satisfies": np.zeros((2, 4), dtype=np.bool_)},
            "No facet satisfies .*usedFor drinking",
        ),
        ({"askable": np.ones((2, 4), dtype=np.bool_)}, "does not satisfy it"),
        ({"askable": np.zeros((2, 4), dtype=np.bool_)}, "The split is empty"),
        (
            {"shown": np.array([False, True, True, True])},
            "red mug, which this split does not show",
        ),
        ({"related": np.triu(np.ones((4, 4), dtype=np.bool_))}, "must be symmetric"),
    ):
        with pytest.raises(UserError, match=message):
            replace(table, **change)


def test_a_question_needs_distractors_of_different_objects(
    table: QuestionTable,
) -> None:
    table.check_objects(2)
    unrelated = replace(table, related=np.eye(4, dtype=np.bool_))
    unrelated.check_objects(1)  # An object alone needs none.
    with pytest.raises(UserError, match="'usedFor drinking' with target red mug"):
        unrelated.check_objects(2)
    with pytest.raises(UserError, match="3 objects per episode need 2"):
        table.check_objects(3)
