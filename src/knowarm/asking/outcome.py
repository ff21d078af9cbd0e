"""Outcome of a question: its answers, where the network sees them, and what the arm did."""

from collections import Counter
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

import numpy as np

from knowarm.asking.answers import Answers
from knowarm.asking.judgements import Judgement
from knowarm.questions import ObjectColour
from knowarm.world.viewing.record import Frame


class AnswerRow(NamedTuple):
    """An object that answers, the colours in which it does, and the judgement on the first."""

    name: str
    colours: str
    judgement: Judgement


@dataclass(frozen=True, kw_only=True)
class Asked:
    """A question, its answers, where the network sees them, and what the arm did."""

    answers: Answers
    """The answers in the graph; where places decide, among what the network names."""
    truth: Answers
    """The same among what stands in the scene; they differ if the network is mistaken."""
    scene: int
    """Number of the scene among the evaluation episodes."""
    shown: tuple[ObjectColour, ...]
    """What stands in the scene; the object that answers comes first, if one does."""
    named: tuple[ObjectColour, ...]
    """What the network names, surest first."""
    points: np.ndarray
    """Where it does, column and row in units of the image, (m, 2)."""
    heat: np.ndarray
    """Share of every place in the choice, (h, w), sum 1."""
    candidates: tuple[ObjectColour, ...]
    """Which of the named objects may answer, at the level of confidence."""
    stopped: bool
    """Whether the arm stayed because it saw no answer, or several."""
    reached: ObjectColour
    """What the gripper was nearest to at the end."""
    distance: float
    """Distance of the gripper from the grasp of that object [m]."""
    angle: float
    """Angle from it [deg]."""
    within: bool
    """Whether both are within the task's thresholds; where there is a ``result``, whether the task
    is solved."""
    film: tuple[Frame, ...]
    """The episode."""
    result: str = ""
    """What became of the object, where reaching it is not all."""
    lacks_place: bool = False
    """Whether the arm stayed because the graph does not say where the object belongs."""
    told: str = ""
    """What the agent was given besides the question, such as which tray is which place."""
    where: str = ""
    """Where the question says that the object has to be put; by default where it belongs."""
    selection: str = ""
    """How the scene was chosen, in a sentence; empty where it was given."""

    @property
    def as_read(self) -> str:
        """The question as it was read, and where the object has to be put if that is named."""
        read = self.answers.as_read
        if self.where:
            return f"{read}, to the tray: {self.where}"
        return read

    @property
    def right(self) -> bool:
        """Whether the arm ended nearest to an object that answers."""
        return self.reached in self.truth.evidence

    @property
    def succeeded(self) -> bool:
        """Whether the arm did what was asked, with an object that answers."""
        return self.right and self.within

    @property
    def outcome(self) -> str:
        """What the arm did, in a sentence."""
        seen = ", ".join(f"the {in_words(facet)}" for facet in self.candidates)
        if self.stopped:
            several = f"several answers: {seen}" if seen else "no answer"
            return f"The arm stayed: it sees {several}."
        if self.lacks_place:
            return (
                "The arm stayed: the graph does not say at which one of these places the object "
                f"belongs: {self.told}."
            )
        judgement = "which answers" if self.right else "which does not answer"
        if self.result:
            went = f"The arm went for the {in_words(self.reached)}, {judgement}"
            sentences = [
                f"{went}.",
                self.result,
                f"It took {self.film[-1].step} steps.",
            ]
            if self.told:
                sentences.insert(0, f"Given: {self.told}.")
            return " ".join(sentences)
        what = "reached" if self.within else "did not arrive; it ended nearest to"
        outcome = (
            f"The arm {what} the {in_words(self.reached)}, {judgement}, after "
            f"{self.film[-1].step} steps: {100 * self.distance:.1f} cm and {self.angle:.0f} "
            "degrees from its grasp."
        )
        if len(self.candidates) > 1:
            outcome += f" It saw several answers: {seen}."
        return outcome

    @property
    def rows(self) -> list[AnswerRow]:
        """Answers by object, which has several rows if it answers in other colours otherwise."""
        judgements = self.answers.judgements
        known = Counter(name for name, _ in self.answers.facets)

        def reasons(facet: ObjectColour) -> tuple[str, ...]:
            seen = f"the image shows {facet[1]}"
            return (facet[0], *filter(seen.__ne__, judgements[facet].evidence))

        rows = []
        for (name, *_), group in groupby(judgements, key=reasons):
            facets = list(group)
            colours = "any"
            if len(facets) < known[name]:
                colours = ", ".join(colour for _, colour in facets)
            rows.append(AnswerRow(name, colours, judgements[facets[0]]))
        return rows

    @property
    def table(self) -> list[list[str]]:
        """Answers: objects, the colours in which they answer, why the first one does."""
        alike: dict[tuple[str, str], list[str]] = {}
        for name, colours, judgement in self.rows:
            why = colours, "; ".join(judgement.evidence)
            alike.setdefault(why, []).append(name)
        return [[", ".join(names), *why] for why, names in alike.items()]


def in_words(facet: ObjectColour) -> str:
    """Return an object with its colour, such as "red mug"."""
    name, colour = facet
    return f"{colour} {name}"
