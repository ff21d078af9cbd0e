"""``knowarm tidy``: a trained agent brings several objects to where a graph says they belong."""

import re
from collections import defaultdict
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from numpy.typing import NDArray

from knowarm.asking.asker import in_words
from knowarm.asking.tidying import Tidied, Tidying, join_scenes, scenes_to_tidy
from knowarm.cli.tables import FilePath, TableCommand, print_table
from knowarm.errors import UserError, printable
from knowarm.experiment.evaluation import Places, told_places
from knowarm.experiment.load import TrainedAgent, load_agent
from knowarm.knowledge import KnowledgeGraph
from knowarm.knowledge.formats import read_graph
from knowarm.knowledge.graph.edits import edited
from knowarm.pictures import animation, data_uri
from knowarm.statistics import wilson
from knowarm.svg import escape
from knowarm.world.config import facets_of
from knowarm.world.tasks.sampling import Episodes
from knowarm.world.tasks.skills.sort.belongings import STANDARD
from knowarm.world.viewing.record import check_page, write_html

EVERY = 3  # Of the steps whose images are kept
FRAME_MS = 150
LAST_MS = 1_500
AT_ONCE = 50  # Scenes that are tidied side by side


@dataclass
class Story:
    """What was told, planned and done in one scene, as lines and films."""

    paragraphs: list[tuple[str, list[NDArray[np.uint8]]]] = field(default_factory=list)

    def tell(self, text: str, film: Sequence[NDArray[np.uint8]] = ()) -> None:
        """Print a line and keep it, with a film below it."""
        print(printable(text), flush=True)
        self.paragraphs.append((text, list(film)))

    def write(self, path: Path, title: str) -> None:
        """Write a self-contained HTML page."""
        body = ""
        for text, film in self.paragraphs:
            body += f"<p>{escape(text)}</p>"
            if film:
                source = data_uri("WEBP", animation(film, FRAME_MS, LAST_MS))
                alt = escape(text, quote=True)
                body += f'<img src="{source}" alt="{alt}" style="max-width: 100%"/>'
        write_html(path, title, body)


@dataclass(frozen=True, kw_only=True)
class Tidy(TableCommand):
    """Tidy a scene: plan by the graph and what the network sees, one object after another."""

    agent: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="[RUN]")] = (
        "zoo/tiago-choose-sort-answers-seen"
    )
    """A run of a sorting task."""
    graph: str | None = None
    """Path of another graph, or the name of a shipped one; default: the run's."""
    edit: tuple[str, ...] = ()
    """Changes of the graph, such as "- mug isLocatedIn kitchen" "+ mug isLocatedIn garage"."""
    after: tuple[str, ...] = ()
    """Changes that follow when a number of objects was brought away, such as "1: - bell
    isLocatedIn classroom"."""
    scene: int = 0
    """Number of the scene, among those to tidy."""
    seed: int = 0
    """Seed of the scenes."""
    page: FilePath = None
    """Write an HTML page with plan and films."""
    scenes: int = 0
    """Instead tidy this many scenes and count."""
    places: Places = "graph"
    """Where objects belong by the agent: by the "graph", or controls: by the "shuffled" one, or
    "unknown"."""

    def result(self) -> dict[str, Any]:
        """Tidy, and print what was done, or counts."""
        later = _later(self.after)
        if self.page is not None:
            check_page(Path(self.page))
        trained = load_agent(self.agent)
        graph = self._graph(trained)
        known = told_places(graph, self.places, trained.config.seed)
        if self.scenes:
            return self._count(trained, graph, known)
        return self._tell(trained, graph, known, later)

    def _graph(self, trained: TrainedAgent) -> KnowledgeGraph:
        """Return the graph that says where things belong."""
        env = trained.config.env
        graph = env.task.asked.answering_graph(facets_of(env))
        if self.graph is not None:
            graph = read_graph(self.graph)
        elif graph is None:
            graph = read_graph(STANDARD)
        return edited(graph, self.edit)

    def _tell(
        self,
        trained: TrainedAgent,
        graph: KnowledgeGraph,
        known: KnowledgeGraph | None,
        later: dict[int, list[str]],
    ) -> dict[str, Any]:
        """Tidy one scene, and tell it step by step."""
        scenes = _take(trained, self.seed, self.scene + 1)
        story = Story()
        with closing(Tidying(trained, scenes[self.scene :], known)) as tidying:
            story.tell(f"It was told: {tidying.instruction(0)}.", [_view(tidying)])
            plans = [_plan(story, tidying)]
            brought = 0
            film: list[NDArray[np.uint8]] = []
            while True:
                which = tidying.step(lambda: film.append(_view(tidying)))[0]
                if which < 0:
                    break
                name = in_words(tidying.facet(0, which))
                look = "is gone from where it was"
                if tidying.is_left(0, which):
                    look = "is still where it was"
                after = f"The arm looks again: the {name} {look}."
                story.tell(after, film[::EVERY])
                film.clear()
                brought += not tidying.is_left(0, which)
                edits = later.pop(brought, [])
                if edits:
                    graph = edited(graph, edits)
                    tidying.graph = edited(tidying.graph or graph, edits)
                    story.tell(f"The graph changes: {'; '.join(edits)}.")
                    plans.append(_plan(story, tidying))
            end = tidying.judge(graph)
            states = _states(tidying, end)
            for name, state in states.items():
                story.tell(f"The {name}: {state}.")
        if self.page is not None:
            story.write(Path(self.page), "KnowArm: tidy")
            print(f"Wrote {self.page}")
        return {
            "scene": self.scene,
            "plans": plans,
            "objects": states,
            "tidy": bool(end.is_tidy[0]),
        }

    def _count(
        self,
        trained: TrainedAgent,
        graph: KnowledgeGraph,
        known: KnowledgeGraph | None,
    ) -> dict[str, Any]:
        """Tidy many scenes, and count."""
        scenes = _take(trained, self.seed, self.scenes)
        parts = []
        for first in range(0, len(scenes), AT_ONCE):
            some = scenes[first : first + AT_ONCE]
            with closing(Tidying(trained, some, known)) as tidying:
                while (tidying.step() >= 0).any():
                    pass
                parts.append(tidying.judge(graph))
        is_due = np.concatenate([part.belongs >= 0 for part in parts])
        counts = {
            "tidy scenes": np.concatenate([part.is_tidy for part in parts]),
            "objects in place": np.concatenate([part.in_place for part in parts])[
                is_due
            ],
            "objects on a wrong tray": np.concatenate(
                [part.wrong_tray for part in parts]
            ).ravel(),
            "scenes in which what should stay was moved": np.concatenate(
                [part.disturbed for part in parts]
            ),
        }
        rows = []
        values: dict[str, float] = {}
        for name, is_so in counts.items():
            share = wilson(int(is_so.sum()), len(is_so))
            values |= share.named(name.replace(" ", "_"))
            ends = f"[{100 * share.low:.0f}, {100 * share.high:.0f}]"
            rows.append([name, f"{100 * share.estimate:.1f} {ends}", len(is_so)])
        print_table(f"Tidied by {trained.config.name}", ["what", "%", "of"], rows)
        return {"scenes": len(scenes), "places": self.places} | values


def _later(changes: Sequence[str]) -> dict[int, list[str]]:
    """Read changes such as "1: - bell isLocatedIn classroom" by their number.

    Raises:
        UserError: one does not begin with a number.
    """
    later = defaultdict(list)
    for change in changes:
        matched = re.fullmatch(r"\s*(\d+)\s*:\s*(.+)", change)
        if matched is None:
            raise UserError(
                "--after takes the number of objects brought away and a change, such as '1: - bell "
                f"isLocatedIn classroom', got {change!r}."
            )
        later[int(matched[1])].append(matched[2])
    return dict(later)


def _take(trained: TrainedAgent, seed: int, count: int) -> Episodes:
    """Return the first scenes to tidy.

    Raises:
        UserError: there are fewer.
    """
    scenes = list(islice(scenes_to_tidy(trained.config.env, seed), count))
    if len(scenes) < count:
        raise UserError(
            f"Of the scenes that can be drawn only {len(scenes)} have an object for each tray, and "
            f"{count} are asked for."
        )
    return join_scenes(scenes)


def _view(tidying: Tidying) -> NDArray[np.uint8]:
    return tidying.env.render()[0]


def _plan(story: Story, tidying: Tidying) -> list[dict[str, Any]]:
    """Tell the plan of a scene; return it as values."""
    errands = tidying.plan(0)
    for errand in errands:
        name = in_words(errand.facet)
        if errand.tray:
            facts = "; ".join(errand.facts)
            text = f"Plan: the {name} to the {errand.tray} tray, the {errand.place}: {facts}."
        else:
            text = f"Plan: the {name} stays: {errand.why}."
        story.tell(text.replace("_", " "))
    return [vars(errand) for errand in errands]


def _states(tidying: Tidying, end: Tidied) -> dict[str, str]:
    """Return how the objects of a scene stand, by name."""
    state = tidying.env.running
    states = {}
    for which, target in enumerate(state.objects[0]):
        colour = state.colours[0, which]
        name = in_words(state.facets[state.first_facet[target] + colour])
        if end.in_place[0, which]:
            text = "stands on the tray of its place"
        elif end.wrong_tray[0, which]:
            text = "stands on a wrong tray"
        elif end.belongs[0, which] >= 0:
            text = "is not on its tray"
        elif end.moved[0, which]:
            text = "should stay, and was moved"
        else:
            text = "stays where it was"
        states[name] = text
    return states
