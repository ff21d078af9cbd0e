"""The story of a scene that is tidied: what was given, the plan, films, and how it ends."""

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knowarm.asking.outcome import in_words
from knowarm.asking.tidying.tidier import Tidying, join_scenes, scenes_to_tidy
from knowarm.errors import UserError
from knowarm.experiment.load import TrainedAgent
from knowarm.knowledge import KnowledgeGraph
from knowarm.knowledge.graph.edits import edited
from knowarm.pictures import animation, data_uri
from knowarm.reading import write_text
from knowarm.svg import render_page
from knowarm.world.tasks.sampling import Episodes
from knowarm.world.tasks.skills.chores import Tidied

EVERY = 3  # Of the steps whose images are kept
FRAME_MS = 150
LAST_MS = 1_500

Film = Sequence[NDArray[np.uint8]]
Later = Mapping[int, Sequence[str]]
"""Changes of the graph by the number of objects after which they follow."""


@dataclass
class Story:
    """What happens in one scene, in the order in which it happens."""

    tell: Callable[[str], None] = lambda text: None
    """Is called with each sentence."""
    paragraphs: list[tuple[str, str]] = field(default_factory=list)
    """Sentences, and the film of what they tell as a data URI, or nothing."""
    plans: list[list[dict[str, Any]]] = field(default_factory=list)
    """The plan, and again after each change of the graph."""
    objects: dict[str, str] = field(default_factory=dict)
    """How each object stands at the end."""
    is_tidy: bool = False
    """Whether all that belong on trays stand there."""

    def add(self, text: str, film: Film = ()) -> None:
        """Add a sentence, with a film."""
        self.tell(text)
        source = ""
        if film:
            source = data_uri("WEBP", animation(film, FRAME_MS, LAST_MS))
        self.paragraphs.append((text, source))

    def add_plan(self, tidying: Tidying) -> None:
        """Add what is planned now."""
        errands = tidying.plan(0)
        for errand in errands:
            name = in_words(errand.facet)
            text = f"Plan: the {name} stays: {errand.why}."
            if errand.tray:
                place = errand.place.replace("_", " ")
                facts = "; ".join(errand.facts)
                text = (
                    f"Plan: the {name} to the {errand.tray} tray, the {place}: {facts}."
                )
            self.add(text)
        self.plans.append([vars(errand) for errand in errands])

    def page(self, form: Mapping[str, Any] | None = None, problem: str = "") -> str:
        """Return it as a self-contained page; with a form where a server changes it."""
        return render_page(
            "knowarm.asking",
            "tidy.html.j2",
            paragraphs=self.paragraphs,
            form=form,
            problem=problem,
        )

    def write(self, path: Path) -> None:
        """Write the page to a file."""
        write_text(path, self.page(), "Name another file.")


def tell(
    trained: TrainedAgent,
    graph: KnowledgeGraph,
    scene: int,
    *,
    seed: int = 0,
    later: Later | None = None,
    story: Story | None = None,
) -> Story:
    """Tidy a scene, and tell it.

    Args:
        trained: an agent that sorts.
        graph: what it knows, by which the end is judged, too.
        scene: number of the scene, among those to tidy.
        seed: seed of the scenes.
        later: changes of the graph, by the number of objects after which they follow.
        story: where it is written.

    Raises:
        UserError: the agent does not sort, there is no such scene, or a change does not fit.
    """
    if story is None:
        story = Story()
    changes = dict(sorted((later or {}).items()))
    graphs = {}
    changed = graph
    for count, edits in changes.items():
        changed = edited(changed, edits)
        graphs[count] = changed
    scenes = take_scenes(trained, scene + 1, seed)[scene:]
    with closing(Tidying(trained, scenes, graph)) as tidying:

        def view() -> NDArray[np.uint8]:
            return tidying.env.render()[0]

        def change(brought: int) -> None:
            """Change the graph after a number of objects."""
            if brought in graphs:
                tidying.graph = graphs.pop(brought)
                story.add(f"The graph changes: {'; '.join(changes[brought])}.")
                story.add_plan(tidying)

        story.add(f"Given: {tidying.instruction(0)}.", [view()])
        story.add_plan(tidying)
        brought = 0
        change(brought)
        film: list[NDArray[np.uint8]] = []
        while (which := tidying.step(lambda: film.append(view()))[0]) >= 0:
            look = "is gone from where it was"
            if tidying.is_left(0, which):
                look = "is still where it was"
            name = in_words(tidying.facet(0, which))
            story.add(f"The arm looks again: the {name} {look}.", film[::EVERY])
            film.clear()
            if not tidying.is_left(0, which):
                brought += 1
                change(brought)
        for count in graphs:
            edits = "; ".join(changes[count])
            story.add(
                f"Not changed: fewer than {count} objects were brought away: {edits}."
            )
        assert tidying.graph is not None
        end = tidying.judge(tidying.graph)
        story.is_tidy = bool(end.is_tidy[0])
        story.objects = _ends(tidying, end)
    for name, text in story.objects.items():
        story.add(f"The {name} {text}.")
    return story


def _ends(tidying: Tidying, end: Tidied) -> dict[str, str]:
    """Return how the objects of a scene stand, by name."""
    state = tidying.env.running
    ends = {}
    for which, target in enumerate(state.objects[0]):
        colour = state.colours[0, which]
        if end.in_place[0, which]:
            text = "stands on the tray of its place"
        elif end.wrong_place[0, which]:
            text = "stands on a tray where it does not belong"
        elif end.belongs[0, which] >= 0:
            text = "is not on its tray"
        elif end.moved[0, which]:
            text = "should stay, and was moved"
        else:
            text = "stays where it was"
        ends[in_words(state.facets[state.first_facet[target] + colour])] = text
    return ends


def take_scenes(trained: TrainedAgent, count: int, seed: int = 0) -> Episodes:
    """Return the first scenes to tidy.

    Raises:
        UserError: there are fewer.
    """
    scenes = list(islice(scenes_to_tidy(trained.config.env, seed), count))
    if len(scenes) < count:
        raise UserError(
            f"Only {len(scenes)} scenes have one object for each tray, and {count} are needed: "
            f"take scenes 0 to {len(scenes) - 1}, or another seed."
        )
    return join_scenes(scenes)


def read_later(changes: Sequence[str]) -> dict[int, list[str]]:
    """Read changes such as "1: - bell isLocatedIn classroom" by their number.

    Raises:
        UserError: one does not begin with a number.
    """
    later: dict[int, list[str]] = {}
    for change in changes:
        matched = re.fullmatch(r"\s*(\d{1,3})\s*:\s*(.+)", change)
        if matched is None:
            raise UserError(
                "A later change is the number of objects that were brought away before it and an "
                f"edit, such as '1: - bell isLocatedIn classroom'; got {change!r}."
            )
        later.setdefault(int(matched[1]), []).append(matched[2])
    return later
