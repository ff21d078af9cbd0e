"""Choice tables: what they accept and what their errors say."""

from dataclasses import replace

import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.world.choice import ChoiceTable

FACETS = (("mug", "red"), ("mug", "blue"), ("jar", "red"), ("can", "blue"))


@pytest.fixture
def table() -> ChoiceTable:
    satisfies = np.array([[name == "mug" for name, _ in FACETS], [c == "red" for _, c in FACETS]])
    return ChoiceTable(
        queries=("usedFor drinking", "hasColor red"),
        facets=FACETS,
        satisfies=satisfies,
        askable=satisfies,
        related=np.ones((4, 4), dtype=np.bool_),
        shown=np.ones(4, dtype=np.bool_),
    )


def test_distractors_are_other_objects_that_do_not_satisfy_the_query(table: ChoiceTable) -> None:
    assert table.distractors(0)[0].tolist() == [False, False, True, True]
    assert table.distractors(1)[0].tolist() == [False, False, False, True]


def test_errors_name_what_to_change(table: ChoiceTable) -> None:
    for change, message in (
        ({"queries": ()}, "queries is empty"),
        ({"queries": ("a", "a")}, "contains 'a' twice"),
        ({"shown": np.ones(3, dtype=np.bool_)}, "shape"),
        ({"satisfies": np.zeros((2, 4), dtype=np.bool_)}, "No facet satisfies .*usedFor drinking"),
        ({"askable": np.ones((2, 4), dtype=np.bool_)}, "does not satisfy it"),
        ({"askable": np.zeros((2, 4), dtype=np.bool_)}, "The split is empty"),
        ({"shown": np.array([False, True, True, True])}, "red mug, which this split does not show"),
        ({"related": np.eye(4, dtype=np.bool_)}, "'usedFor drinking' with target red mug"),
        ({"related": np.triu(np.ones((4, 4), dtype=np.bool_))}, "must be symmetric"),
    ):
        with pytest.raises(UserError, match=message):
            replace(table, **change)


def test_a_question_needs_distractors_of_different_objects(table: ChoiceTable) -> None:
    table.check_objects(2)
    with pytest.raises(UserError, match="3 objects per episode need 2"):
        table.check_objects(3)
