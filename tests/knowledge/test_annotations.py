"""What RDF 1.2 says about triples: their confidence is read, the rest is left out with a line."""

import pytest

from tests.knowledge.ontologies import local, read

MUG = "mug usedFor drinking"
TRIPLE = ":mug :usedFor :drinking"


@pytest.mark.parametrize(
    ("text", "confidence"),
    [
        (TRIPLE + " {| :confidence .2 |} .", 0.2),
        (TRIPLE + " {| :hasConfidence .2e0 |} .", 0.2),
        (TRIPLE + ' {| :probability "0.2" |} .', 0.2),
        (TRIPLE + " {| :Certainty 0 |} .", 0),
        (TRIPLE + " {| :weight .25 |} .", 0.25),
        (TRIPLE + " {| :confidence .2 |} {| :confidence .7 |} .", 0.7),
        (TRIPLE + " ~ :r . :r :confidence .3 .", 0.3),
        (":r :confidence .3 . " + TRIPLE + " ~ :r .", 0.3),
        (f":r :confidence .3 ; rdf:reifies <<( {TRIPLE} )>> . {TRIPLE} .", 0.3),
        (f"{TRIPLE} . << {TRIPLE} >> :confidence .4 .", 0.4),
        (f"<< {TRIPLE} >> :confidence .4 . {TRIPLE} .", 0.4),
        (TRIPLE + " {| :confidence 1 |} .", None),
    ],
)
def test_confidence_is_read(tmp_path, text, confidence):
    graph, messages = read(tmp_path, text)
    assert local(graph) == {MUG}
    assert list(graph.confidence.values()) == [confidence] * (confidence is not None)
    assert messages == []


@pytest.mark.parametrize(
    ("text", "expected", "message"),
    [
        (TRIPLE + " {| :source :web |} .", {MUG}, "1 statements about triples"),
        (TRIPLE + " {| :weight 7 |} .", {MUG}, "1 statements about triples"),
        (TRIPLE + " {| :confidence :high |} .", {MUG}, "1 statements about triples"),
        (f":pan :hasColor :red . << {TRIPLE} >> :confidence .9 .", {"pan hasColor red"},
         "1 triples that are quoted"),
        (f":pan :hasColor :red . << {TRIPLE} >> :confidence 1 .", {"pan hasColor red"},
         "1 triples that are quoted"),
        (f":bob :says <<( {TRIPLE} )>> ; :age 5 .", {"bob age integer>"},
         "1 statements about triples"),
    ],
)  # fmt: skip
def test_what_else_is_said_is_left_out(tmp_path, text, expected, message):
    graph, messages = read(tmp_path, text)
    assert local(graph) == expected
    assert graph.confidence == {}
    assert len(messages) == 1
    assert message in messages[0]


def test_confidence_of_unnamed_nodes_is_read(tmp_path):
    graph, _ = read(tmp_path, ":mug :on [ :near :pan ] {| :confidence .6 |} .")
    ((head, _, tail),) = graph.confidence
    assert (head, tail) == ("http://e.org/mug", "_:unnamed0")
