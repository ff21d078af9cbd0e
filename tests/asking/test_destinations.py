"""A destination that a question names counts more than where the graph says that things belong."""

from contextlib import closing
from pathlib import Path

import pytest

from knowarm.asking.asker import Asker
from knowarm.asking.destinations import read_destination
from knowarm.asking.lexicon import DESTINATIONS, HOME, match_putting, what_is_put
from knowarm.errors import UserError
from knowarm.experiment.load import load_agent

pytestmark = pytest.mark.usefixtures("small_films")

RUN = Path(__file__).parents[2] / "zoo" / "tiago-choose-sort-answers-seen"
TOLD = "the cyan tray is the garage; the yellow tray is the kitchen"


@pytest.mark.parametrize(
    ("text", "what", "where"),
    [
        ("put the red mug on the kitchen's tray", "the red mug", "kitchen"),
        ("Put the mug on the kids' tray.", "the mug", "kids"),
        ("put what is used for drinking on the blue tray", "what is used for drinking", "blue"),
        ("could you put the mug on the garage tray?", "the mug", "garage"),
        ("bring the bell to the classroom", "the bell", "classroom"),
        ("Please put the mug onto the tray of the living room.", "the mug", "living room"),
        ("put the mug on the tray that is blue", "the mug", "blue"),
        ("put the thing on the left on the blue tray", "the thing on the left", "blue"),
        ("put the mug back in the kitchen, please", "the mug", "kitchen"),
        ("I want the mug on the blue tray", "I want the mug", "blue"),
        ("move something from the kitchen to the garden", "something from the kitchen", "garden"),
        # What is no tray is refused by its name, and never left out.
        ("put the mug to the left of the blue tray", "the mug", "left of the blue"),
        ("put the mug in front of the blue tray", "the mug", "front of the blue"),
        ("put the mug on the tray", "the mug", "tray"),
        ("move the mug to the left", "the mug", "left"),
    ],
)  # fmt: skip
def test_sentences_with_a_destination(text, what, where):
    assert read_destination(text)[:2] == (what, where)


@pytest.mark.parametrize(
    "text",
    [
        "put the mug where it belongs",
        "put the mug on its tray",
        "put the mug away",
        "put the mug in its place, please",
        "bring something for the kitchen",
        "take the mug in the kitchen",
        "something to drink from that is not blue",
        "usedFor drinking and isLocatedIn kitchen",
        "SELECT ?object WHERE { ?object :usedFor :drinking }",
    ],
)
def test_sentences_without_one(text):
    assert read_destination(text) is None


@pytest.mark.parametrize("forms", [DESTINATIONS, HOME], ids=["destinations", "home"])
def test_each_pattern_reads_its_example_and_no_earlier_one_does(forms):
    for form in forms:
        readers = [
            other for other in forms if match_putting(other["pattern"], form["example"])
        ]
        assert readers[0] == form


def test_please_stands_on_either_side():
    assert (
        what_is_put("Could you please put the mug where it belongs, please?")
        == "the mug"
    )


@pytest.fixture(scope="module")
def asker():
    with closing(Asker(load_agent(RUN))) as made:
        yield made


def test_it_is_put_where_the_question_says_and_judged_so(asker):
    garage = asker.ask("put the red mug on the garage's tray", scene=1)
    assert garage.told == TOLD
    assert garage.as_read == "hasColor red and is mug, to the tray: garage"
    assert garage.result == "It stands on the cyan tray, the garage."
    assert garage.within  # though the graph says that it belongs in the kitchen


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("put the red mug on the attic's tray", "no tray 'attic'"),
        ("bring the red mug to the garden", "no tray 'garden'"),
        ("put the red mug on the tray", "no tray 'tray'"),
        ("do not put the red mug on the cyan tray", "not understood"),
        ("put the red mug on the tray next to the cyan tray", "not understood"),
    ],
)
def test_other_destinations_are_refused_with_those_of_the_scene(asker, text, words):
    with pytest.raises(UserError, match=words) as refused:
        asker.ask(text, scene=1)
    if "tray" in words:
        assert f"In scene 1 {TOLD}." in str(refused.value)
    assert "\n" not in str(refused.value)


def test_what_needs_no_destination_is_asked_as_before(asker):
    # "next to" is no way to a tray that is called "mug".
    assert asker.ask("take the thing next to the mug", scene=1).where == ""


def test_a_scene_that_there_is_not_is_refused(asker):
    with pytest.raises(UserError, match="scene must be 0 to"):
        asker.ask("put the red mug on the cyan tray", scene=4000)
