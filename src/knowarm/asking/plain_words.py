"""Questions in plain English, read as those of `expressions` by the vocabulary of a graph.

    the red mug                                ->  hasColor red and is mug
    something to drink from that is not red    ->  usedFor drinking and not hasColor red
    the thing to the left of the bowl          ->  leftOf (is bowl)

Every word is accounted for: as a value, as the name of an object, as a cue for a relation ("made
of"), as one that joins or negates, or as one of a few that change nothing. What is done with an
object ("to water the flowers") and its kind ("a tool") are left out, and it is said. All readings
are enumerated, and the nearest one counts if it is the only one. Anything else is refused, with
the nearest conditions of the graph.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from knowarm.asking.grammar import Reader
from knowarm.asking.lexicon import (
    UNANSWERED,
    WORDS,
    sentences,
    tokens,
    what_is_put,
)
from knowarm.asking.readings import ReadCondition, is_clear, joined
from knowarm.asking.relations import PLACES
from knowarm.asking.vocabulary import Vocabulary
from knowarm.errors import UserError

Holders = Callable[[str], set[int]]
"""The entities of which a question is true."""


class PlainReading(NamedTuple):
    """A question as `expressions` write it, and what was left out of it."""

    text: str
    left_out: tuple[str, ...] = ()


def read_plain(text: str, vocabulary: Vocabulary, holders: Holders) -> PlainReading:
    """Read a question in plain English, as `expressions` write it.

    Args:
        text: the question.
        vocabulary: what can be asked.
        holders: tells of which entities a question is true, for superlatives.

    Raises:
        UserError: the question is not understood, or can be understood in several ways.
    """
    conditions: list[ReadCondition] = []
    left_out = []
    error = None
    for sentence in sentences(text):
        words = tokens(what_is_put(sentence))
        reader = Reader(text, words, vocabulary)
        if UNANSWERED.match(" ".join(words)):
            raise reader.refused("only questions for an object are answered")
        try:
            end = reader.best()
        except UserError as refused:
            if words[0] not in WORDS.speaker or reader.words.has_object:
                raise
            error = refused.with_traceback(None)
            left_out.append(sentence)
            continue
        left_out += reader.words.phrases(end.left_out)
        first, *others = end.done
        if conditions and first.join == "or":
            raise reader.refused("'or' joins no sentences")
        if conditions:
            first = replace(first, join="but")
        conditions += [first, *others]
        if not is_clear(conditions):
            raise reader.refused("its sentences do not fit together")
    if not conditions:
        raise error or UserError(f"The question {text!r} has no words.")
    question = _with_extreme(conditions, reader, holders)
    return PlainReading(question, tuple(left_out))


def _with_extreme(
    conditions: Sequence[ReadCondition], reader: Reader, holders: Holders
) -> str:
    """Return conditions as one question, with the number that a superlative means."""
    best = [condition for condition in conditions if condition.best]
    if not best:
        return joined(conditions)
    superlative = best[0]
    rest = [condition for condition in conditions if condition is not superlative]
    others = {condition.relation.name for condition in rest}
    if (
        superlative.negated
        or any(condition.best or condition.join == "or" for condition in rest)
        or superlative.join == "or"
        or not others.isdisjoint(PLACES)
    ):
        raise reader.refused(
            "it may hold one superlative, which 'and' joins, and then no place in the image"
        )
    extreme = _extreme(superlative, rest, holders)
    if extreme is None:
        raise reader.refused(
            f"no object that it is about has a number of {superlative.relation.name}"
        )
    return joined([*rest, extreme])


def _extreme(
    superlative: ReadCondition, rest: Sequence[ReadCondition], holders: Holders
) -> ReadCondition | None:
    """Return the comparison with the largest or smallest number that an object has, if any has.

    An individual has the numbers of its class, so that answers are asked, and not the graph.
    """

    def compared(sign: str, number: float) -> ReadCondition:
        return ReadCondition(f"{superlative.text} {sign} {number:.15g}")

    def is_true(sign: str, number: float) -> bool:
        return bool(holders(joined([*rest, compared(sign, number)])))

    is_largest = superlative.best == ">"
    if superlative.text.startswith("count "):
        if not is_true(">=", 0):
            return None
        number = 0
        while is_true(">", number) and (is_largest or not is_true("<=", number)):
            number += 1
        return compared("=", number)
    numbers = set(superlative.relation.numbers.values())
    for quantity in sorted(numbers, reverse=is_largest):
        if is_true("=", quantity):
            return compared("=", quantity)
    return None
