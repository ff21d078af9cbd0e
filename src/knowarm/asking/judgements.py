"""Judgements: whether a condition is true of what is asked about, how surely, and why.

A graph states a fact, denies it, or says nothing about it. What it does not say is false, and the
judgement tells that it rests on that.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from math import prod
from operator import attrgetter

from knowarm.questions import SURE

Place = tuple[float, float]
"""Column and row in the image, in units of its size."""
Evidence = tuple[str, ...]
"""Why a judgement holds: triples of the graph, what the image shows, and what is not stated."""


@dataclass(frozen=True, eq=False)
class Individual:
    """One thing that a question may be true of: an object as it is seen, or an entity."""

    entity: int | None
    """Its entity in the graph; None of an object that the graph does not describe."""
    name: str = ""
    """The name of the object; "" of an entity that is not shown."""
    colour: str | None = None
    """The colour in which it is shown."""
    place: Place | None = None
    """Where it stands in the image; None where no scene is known."""
    scene: Sequence["Individual"] = ()
    """All that is shown beside it, itself among them."""


@dataclass(frozen=True)
class Judgement:
    """Whether a condition is true of an individual, and why."""

    holds: bool
    evidence: Evidence = ()
    probability: float = 1.0
    """Probability that the condition is true, by the confidence of facts."""
    is_stated: bool = True
    """Whether the graph or the image says so; False if it rests on what the graph does not say."""
    is_denied: bool = False
    """Whether the graph says so by denying something."""
    is_open: bool = False
    """Whether the places in a scene decide it, and none is known."""
    is_unsettled: bool = False
    """Whether neither the condition nor its negation counts, since the graph contradicts itself
    or does not describe the object."""

    @property
    def answers(self) -> bool:
        """Whether the individual is, or may be, an answer."""
        return self.holds and not self.is_unsettled

    @property
    def is_false(self) -> bool:
        """Whether the condition is settled, and not true."""
        return not (self.holds or self.is_open or self.is_unsettled)


Part = Callable[[Individual], Judgement]
"""A part of a question."""


def certain(holds: bool, *evidence: str) -> Judgement:
    """Return the judgement on what is seen or counted: it holds for sure, or surely not."""
    return Judgement(holds, evidence, float(holds))


def undescribed(individual: Individual) -> Judgement:
    """Return the judgement on facts about an object that the graph does not describe."""
    reason = f"the graph does not describe {individual.name}"
    return Judgement(False, (reason,), 0.0, is_unsettled=True)


def settled(
    stated: Judgement | None, denied: Judgement | None, missing: str
) -> Judgement:
    """Return the judgement on a fact by what states and what denies it; ``missing`` names it.

    Evidence of both that is more probable than not contradicts itself.
    """
    if denied is None or denied.probability < SURE:
        if stated is None:
            return Judgement(False, (f"not stated: {missing}",), 0.0, is_stated=False)
        return replace(stated, holds=stated.probability >= SURE)
    if stated is None or stated.probability < SURE:
        return Judgement(False, denied.evidence, 0.0, is_denied=True)
    both = (*stated.evidence, *denied.evidence)
    return Judgement(False, both, 0.0, is_unsettled=True)


def negated(judgement: Judgement) -> Judgement:
    """Return the judgement on a negation."""
    holds = not judgement.holds or judgement.is_open
    return replace(judgement, holds=holds, probability=1 - judgement.probability)


def conjunction(judgements: Iterable[Judgement]) -> Judgement:
    """Return the judgement on conditions that are joined by "and"; facts are independent."""
    judgements = tuple(judgements)
    probability = prod(map(attrgetter("probability"), judgements), start=1.0)
    false = list(filter(attrgetter("is_false"), judgements))
    if false:
        surest = max(false, key=attrgetter("is_stated"))
        return replace(surest, probability=probability)
    is_unsettled = any(map(attrgetter("is_unsettled"), judgements))
    is_open = any(map(attrgetter("is_open"), judgements))
    return Judgement(
        holds=not is_unsettled and (is_open or probability >= SURE),
        evidence=tuple(chain.from_iterable(map(attrgetter("evidence"), judgements))),
        probability=probability,
        is_stated=all(map(attrgetter("is_stated"), judgements)),
        is_denied=any(map(attrgetter("is_denied"), judgements)),
        is_open=is_open,
        is_unsettled=is_unsettled,
    )


def disjunction(judgements: Iterable[Judgement]) -> Judgement:
    """Return the judgement on conditions that are joined by "or"."""
    return negated(conjunction(map(negated, judgements)))


def surest(judgements: Iterable[Judgement]) -> Judgement:
    """Return the judgement of several that answers best: stated before not stated."""
    return max(judgements, key=attrgetter("answers", "is_stated", "probability"))
