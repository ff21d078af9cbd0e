"""Where things stand in the image: conditions such as leftOf (is vase), nearest (...), leftmost."""

from collections.abc import Callable, Sequence
from math import dist

from knowarm.asking.judgements import Individual, Judgement, Part

_Side = Callable[[float, float], bool]
"""Whether the way to another thing, right and down in the image, leads to one side."""

SIDES: dict[str, _Side] = {
    "leftOf": lambda right, down: right > 0,
    "rightOf": lambda right, down: right < 0,
    "behind": lambda right, down: down > 0,
    "inFrontOf": lambda right, down: down < 0,
}
"""Conditions on the side of something; what is nearer to the viewer is lower in the image."""

ENDS: dict[str, tuple[int, int]] = {
    "leftmost": (0, 1),
    "rightmost": (0, -1),
    "hindmost": (1, 1),
    "frontmost": (1, -1),
}
"""Conditions on the end of the scene: the axis of the image, and the sign of the least."""

DISTANCES: dict[str, int] = {"nearest": 1, "farthest": -1}
"""Conditions on the distance from something in the image."""


class Superlative:
    """A part that compares an individual with the others of which a question is true.

    Args:
        text: the part as it is written.
        measure: how far an individual is from being the one; the least is.
    """

    def __init__(
        self, text: str, measure: Callable[[Individual], float | None]
    ) -> None:
        self.text = text
        self.measure = measure

    def __call__(self, individual: Individual) -> Judgement:
        """Compare with all that is shown."""
        return self.among(individual, individual.scene)

    def among(self, individual: Individual, rivals: Sequence[Individual]) -> Judgement:
        """Compare with some of what is shown."""
        if individual.place is None:
            return Judgement(True, (f"by its place: {self.text}",), is_open=True)
        mine = self.measure(individual)
        if mine is None:
            return Judgement(False, (f"the image does not show: {self.text}",), 0.0)
        others = [self.measure(rival) for rival in rivals]
        is_it = all(other is None or mine <= other for other in others)
        verb = "shows" if is_it else "does not show"
        return Judgement(is_it, (f"the image {verb}: {self.text}",), float(is_it))


def beside(text: str, is_side: _Side, of: Part) -> Part:
    """Return the part that is true on one side of something of which a question is true.

    Args:
        text: the part as it is written.
        is_side: the side on which the other one stands, seen from this one.
        of: the question.
    """

    def part(individual: Individual) -> Judgement:
        if individual.place is None:
            return Judgement(True, (f"by its place: {text}",), is_open=True)
        column, row = individual.place
        for other in individual.scene:
            if other is individual or other.place is None or not of(other).answers:
                continue
            if is_side(other.place[0] - column, other.place[1] - row):
                return Judgement(True, (f"the image shows: {text}",))
        return Judgement(False, (f"the image does not show: {text}",), 0.0)

    return part


def at_end(name: str) -> Superlative:
    """Return the part that is true of what stands at one end: key of `ENDS`."""
    axis, sign = ENDS[name]

    def measure(individual: Individual) -> float | None:
        return sign * individual.place[axis] if individual.place else None

    return Superlative(name, measure)


def by_distance(text: str, name: str, of: Part) -> Superlative:
    """Return the part that is true of what is nearest to something: key of `DISTANCES`.

    That of which the question itself is true does not count.
    """

    def measure(individual: Individual) -> float | None:
        if individual.place is None or of(individual).answers:
            return None
        sign = DISTANCES[name]
        places = [other.place for other in individual.scene if of(other).answers]
        ways = [sign * dist(individual.place, place) for place in places if place]
        return min(ways, default=None)

    return Superlative(text, measure)
