"""The page of a question: reading first, then what the arm did, then on what each answer rests."""

import re
from types import SimpleNamespace

import pytest

from knowarm.asking.answers import answer
from knowarm.asking.asker import Asker
from knowarm.asking.outcome import Asked
from knowarm.asking.page import BASES, page, reasons
from knowarm.experiment.load import load_agent
from knowarm.knowledge import graph_of
from tests.asking.test_offered import RUN

pytestmark = pytest.mark.usefixtures("small_films")

FACETS = [
    (name, hue) for name in ("mug", "jar", "bowl", "lamp") for hue in ("red", "blue")
]
GRAPH = graph_of(
    [
        ("mug", "usedFor", "drinking"),
        ("bowl", "usedFor", "drinking"),
        ("jar", "notUsedFor", "drinking"),
        ("lamp", "isA", "light"),
    ],
    confidence={("bowl", "usedFor", "drinking"): 0.75},
)


def rows(question):
    answers = answer(GRAPH, FACETS, question)
    known = dict.fromkeys(("mug", "jar", "bowl", "lamp"), 2)
    asked = SimpleNamespace(answers=answers, known=known)
    asked.rows = Asked.rows.fget(asked)
    return reasons(asked)


@pytest.mark.parametrize(
    ("question", "expected"),
    [
        (
            "usedFor drinking",
            [("mug", "stated", 1.0), ("bowl", "stated", 0.75)],
        ),
        (
            "not usedFor drinking",
            [("jar", "denied", 1.0), ("lamp", "not stated", 1.0)],
        ),
        ("is jar and hasColor red", [("jar", "seen", 1.0)]),
        ("leftOf (is jar)", [("mug, jar, bowl, lamp", "seen", 1.0)]),
        ("not isA light", [("mug, jar, bowl", "not stated", 1.0)]),
        (
            "usedFor drinking and not isA light",
            [("mug", "not stated", 1.0), ("bowl", "not stated", 0.75)],
        ),
        ("is lamp or usedFor drinking", None),
    ],
)
def test_each_answer_says_on_what_it_rests(question, expected):
    found = rows(question)
    assert all(row.basis in BASES for row in found)
    order = [list(BASES).index(row.basis) for row in found]
    assert order == sorted(order)
    if expected is not None:
        shown = [(row.names, row.basis, row.probability) for row in found]
        assert shown == expected


def test_the_reading_comes_first_and_rests_are_marked(tmp_path):
    path = tmp_path / "home.csv"
    path.write_text(
        "head,relation,tail,confidence\nmug,usedFor,drinking,.75\n"
        "bottle,notUsedFor,drinking,\nlamp,usedFor,lighting,\n"
    )
    asker = Asker(load_agent(RUN), path)
    question = "not usedFor drinking"
    text = page(asker.ask(question), question, (), asker=asker)
    parts = ["I read this as", "<code>not usedFor drinking", 'class="verdict', "<figure>",
             "Answers in the graph", 'class="basis denied"', "bottle notUsedFor drinking",
             'class="basis not"', "<b>Denied</b>", "Try:", "What can be asked"]  # fmt: skip
    places = [text.index(part) for part in parts]
    assert places == sorted(places)
    assert "<b>Stated</b>" not in text
    assert "probability" not in re.sub(r"<style>.*?</style>", "", text, flags=re.DOTALL)
    positive = page(asker.ask("usedFor drinking"), "usedFor drinking", ())
    assert "probability 0.75" in positive
    assert "Try:" not in positive  # a written page asks nothing
    asker.close()
