"""What the page offers to click: each fact is answered by the objects of which it is true."""

import html
import re
from contextlib import suppress
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import pytest

from knowarm.asking.answers import answer, words
from knowarm.asking.asker import Asker
from knowarm.asking.page import page
from knowarm.asking.quotes import condition, quoted, unquoted
from knowarm.cli.knowledge.options import ObjectOptions
from knowarm.errors import UserError
from knowarm.experiment.load import load_agent
from knowarm.knowledge import graph_of, read_graph
from knowarm.knowledge.formats import SHIPPED
from knowarm.questions import COLOUR_RELATION
from tests.thorough import share

pytestmark = pytest.mark.usefixtures("unfenced")

RUN = Path(__file__).parents[2] / "zoo" / "irb120-choose-subgraph-fast"
STRANGE = (
    "used for", "a  b", "and", "or", "not", "count", "is", "leftmost", "nearest", "leftOf",
    'a "b"', '"', "a\\b", '\\"', "a/b", "a(b)", ")", "a = b", ">=", "x!", "größe", "Größe ß",
    "大きさ", "e\u0301", "50%", "a&b=c", "#1", "1", "1.5", "2020-01-01", "something that is red",
)  # fmt: skip
"""Names of relations and values that a question might take for something else."""
TURTLE = """@prefix k: <http://example.org/kitchen#> .
@prefix o: <http://example.org/other/> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
k:mug k:usedFor k:Drinking, o:drinking ; o:usedFor k:tea%20time ; k:madeOf "clay", k:clay ;
    o:with <http://example.org/a(b)>, <urn:x:y=z>, o:caf\u00e9 ; a k:Cup ; k:notUsedFor k:war .
k:Drinking rdfs:label "and" . k:usedFor rdfs:label "is" . k:bowl k:usedFor o:drinking ;
    k:kind k:red, [ k:p k:q ] . k:Cup rdfs:subClassOf k:Dish . k:Dish k:kind o:Dish ."""


INSTANCES = """@prefix : <http://example.org/home#> .
:obj17 a :Mug ; :on :table ; :contains :hot_coffee . :obj18 a :Mug ; :on :shelf ; :near "wall" .
:bowl_0 a :Bowl ; :on :table ; :next_to :obj17 . :Mug :usedFor :drinking ; :notUsedFor :eating .
:Bowl :madeOf :clay, :glass ; :kind "a (b)" . :obj19 a :Bowl ; :on <http://example.org/a(b)c> ;
    :in :living_room, :kitchen ; :held_by :nobody ; :leftOf :obj18 ; :stands_on :obj17 ."""


def strange():
    triples = []
    for number, name in enumerate(STRANGE):
        triples.append(("mug", name, "clay"))
        triples.append((("mug", "bowl")[number % 2], "isA", name))
        triples.append(("bowl", name, STRANGE[number - 7]))
    return graph_of(triples)


def graphs(tmp_path):
    file = tmp_path / "kitchen.ttl"
    file.write_text(TURTLE, encoding="utf-8")
    rooms = tmp_path / "rooms.ttl"
    rooms.write_text(INSTANCES)
    return {
        "strange": strange(),
        "turtle": read_graph(file),
        "instances": read_graph(rooms),
    }


@pytest.mark.parametrize("name", ["strange", "turtle", "instances", *SHIPPED])
def test_every_fact_that_is_offered_is_answered(tmp_path, name):
    if name in SHIPPED:
        graph = read_graph(name)
        options = ObjectOptions(graph=name)
        facets = options.facets(graph)
        if name == "families":
            facets = facets[::82]  # of other objects and colours
    else:
        graph = graphs(tmp_path)[name]
        facets = [(thing, hue) for thing in ("mug", "bowl") for hue in ("red", "blue")]
    offered = words(graph, facets)
    assert sum(map(len, offered.values())) > 10
    for relation, values in offered.items():
        for value, names in share(values.items(), 0, 3):
            text = condition(relation, value)
            answers = answer(graph, facets, text)
            assert answers.question == text
            answering = {thing for thing, _ in answers.evidence}
            if relation == COLOUR_RELATION:
                names = [thing for thing, hue in facets if hue == value]
            assert set(names) <= answering, text


@pytest.mark.parametrize("name", ["strange", "turtle", "instances"])
def test_every_link_of_the_page_is_answered_or_says_who_answers(tmp_path, name):
    asker = Asker(load_agent(RUN), graphs(tmp_path)[name])
    text = page(None, "", (), asker=asker)
    links = re.findall(r'href="(/\?q=[^"]+)"', text)
    assert len(links) > 15
    for link in share(links, 0, 3):
        query = parse_qs(urlsplit(html.unescape(link)).query)["q"][0]
        answers = asker.answers(query)
        assert answers.judgements, query
        problem = ""
        try:
            asker.scene([answers])
        except UserError as error:
            problem = str(error)
        assert re.match("^$|No scene shows what answers .*: |In none of ", problem)
    asker.close()


def test_facts_that_are_less_probable_than_not_are_not_offered():
    doubtful = {("mug", "holds", "tea"): 0.4, ("mug", "holds", "milk"): 0.5}
    graph = graph_of([*doubtful, ("mug", "holds", "ink")], confidence=doubtful)
    assert words(graph, [("mug", "red")])["holds"].keys() == {"milk", "ink"}


def test_names_are_quoted_and_read_again():
    for name in (*STRANGE, "mug", "a\\\\", 'a"', "\\", " x "):
        assert unquoted(quoted(name)) == name
        with suppress(UserError):
            graph = graph_of([("mug", name, name)])
            question = f"not {condition(name, name)} or {condition(name, name)}"
            (facet,) = answer(graph, [("mug", "red")], question).evidence
            assert facet == ("mug", "red")
    for name in ("mug", "a/b", "größe", "50%", "http://x#a"):
        assert quoted(name) == name
