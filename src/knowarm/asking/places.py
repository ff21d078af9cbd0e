"""Where things stand in the image: conditions such as leftOf (is vase), nearest (...), leftmost."""

from collections.abc import Callable, Sequence
from math import dist

from knowarm.asking.judgements import Individual, Judgement, Part, Place, certain

SIDES = {
    "leftOf": (0, -1),
    "rightOf": (0, 1),
    "behind": (1, -1),
    "inFrontOf": (1, 1),
}
"""Conditions on the side of something: the axis of the image, and the sign of the places that are
further to that side. What is nearer to the viewer is lower in the image."""

ENDS = {
    "leftmost": SIDES["leftOf"],
    "rightmost": SIDES["rightOf"],
    "hindmost": SIDES["behind"],
    "frontmost": SIDES["inFrontOf"],
}
"""Conditions on the end of the scene."""

DISTANCES = {"nearest": -1, "farthest": 1}
"""Conditions on the distance from something in the image: the sign of what is furthest."""


class Superlative:
    """A part that compares an individual with the others of which a question is true.

    Args:
        text: the part as it is written.
        measure: how far an individual is at its place; the furthest one is meant.
    """

    def __init__(
        self, text: str, measure: Callable[[Individual, Place], float | None]
    ) -> None:
        self.text = text
        self.measure = measure

    def __call__(self, individual: Individual) -> Judgement:
        """Compare with all that is shown."""
        return self.among(individual, individual.scene)

    def among(self, individual: Individual, rivals: Sequence[Individual]) -> Judgement:
        """Compare with some of what is shown."""
        if individual.place is None:
            return _open(self.text)
        mine = self.measure(individual, individual.place)
        if mine is None:
            return _shown(self.text, False)
        others = [self.measure(rival, rival.place) for rival in rivals if rival.place]
        return _shown(
            self.text, all(other is None or mine >= other for other in others)
        )


def _open(text: str) -> Judgement:
    """Return the judgement on a place where no scene is known."""
    return Judgement(True, (f"by its place: {text}",), is_open=True)


def _shown(text: str, is_it: bool) -> Judgement:
    """Return the judgement of the image on a place."""
    verb = "shows" if is_it else "does not show"
    return certain(is_it, f"the image {verb}: {text}")


def _places(individual: Individual, of: Part) -> list[Place]:
    """Return the places of what is shown beside an individual, and of which a part is true."""
    others = [other for other in individual.scene if other is not individual]
    return [other.place for other in others if other.place and of(other).answers]


def beside(text: str, name: str, of: Part) -> Part:
    """Return the part that is true on one side of something of which a question is true.

    Args:
        text: the part as it is written.
        name: key of `SIDES`.
        of: the question.
    """
    axis, sign = SIDES[name]

    def part(individual: Individual) -> Judgement:
        place = individual.place
        if place is None:
            return _open(text)
        others = _places(individual, of)
        is_it = any(sign * place[axis] > sign * other[axis] for other in others)
        return _shown(text, is_it)

    return part


def at_end(name: str) -> Superlative:
    """Return the part that is true of what stands at one end: key of `ENDS`."""
    axis, sign = ENDS[name]
    return Superlative(name, lambda individual, place: sign * place[axis])


def by_distance(text: str, name: str, of: Part) -> Superlative:
    """Return the part that is true of what is nearest to something: key of `DISTANCES`.

    That of which the question itself is true does not count.
    """
    sign = DISTANCES[name]

    def measure(individual: Individual, place: Place) -> float | None:
        if of(individual).answers:
            return None
        ways = [sign * dist(place, other) for other in _places(individual, of)]
        return max(ways, default=None)

    return Superlative(text, measure)
