"""``knowarm tidy``: a trained agent brings several objects to where a graph says they belong."""

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from knowarm.asking.tidying.story import Story, read_later, take_scenes, tell
from knowarm.asking.tidying.tidier import Tidying, standard_graph
from knowarm.cli.tables import FilePath, TableCommand, print_table
from knowarm.errors import UserError, printable
from knowarm.experiment.evaluation import Places, told_places
from knowarm.experiment.load import TrainedAgent, load_agent
from knowarm.knowledge import KnowledgeGraph
from knowarm.knowledge.formats import read_graph
from knowarm.knowledge.graph.edits import edited
from knowarm.statistics import wilson
from knowarm.world.viewing.record import check_page

AT_ONCE = 50  # Scenes that are tidied side by side


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
    """With --scenes, where objects belong by the agent: by the "graph", or controls: by the
    "shuffled" one, or "unknown"."""
    blind: bool = False
    """With --scenes, a control: all images that the agent sees are black."""

    def result(self) -> dict[str, Any]:
        """Tidy, and print what is done, or counts."""
        if self.page is not None:
            check_page(Path(self.page))
        if self.scenes and (self.page or self.after):
            raise UserError(
                "--scenes counts, and tells no story: leave out --page and --after."
            )
        if (self.places != "graph" or self.blind) and not self.scenes:
            raise UserError(
                "--places and --blind are controls that count: add --scenes 100."
            )
        later = read_later(self.after)
        trained = load_agent(self.agent)
        graph = standard_graph(trained)
        if self.graph is not None:
            graph = read_graph(self.graph)
        graph = edited(graph, self.edit)
        if self.scenes:
            return self._count(trained, graph)
        story = Story(lambda text: print(printable(text), flush=True))
        tell(trained, graph, self.scene, seed=self.seed, later=later, story=story)
        if self.page is not None:
            story.write(Path(self.page))
            print(f"Wrote {self.page}")
        return {
            "scene": self.scene,
            "plans": story.plans,
            "objects": story.objects,
            "tidy": story.is_tidy,
        }

    def _count(self, trained: TrainedAgent, graph: KnowledgeGraph) -> dict[str, Any]:
        """Tidy many scenes, and count."""
        known = told_places(graph, self.places, trained.config.seed)
        scenes = take_scenes(trained, self.scenes, self.seed)
        ends = []
        for first in range(0, len(scenes), AT_ONCE):
            some = scenes[first : first + AT_ONCE]
            made = Tidying(trained, some, known, blind=self.blind)
            with closing(made) as tidying:
                while (tidying.step() >= 0).any():
                    pass
                ends.append(tidying.judge(graph))
        is_due = np.concatenate([end.belongs >= 0 for end in ends])
        in_place = np.concatenate([end.in_place for end in ends])
        counts = {
            "tidy scenes": np.concatenate([end.is_tidy for end in ends]),
            "objects in place": in_place[is_due],
            "scenes with an object on a wrong tray": np.concatenate(
                [end.wrong_place.any(axis=1) for end in ends]
            ),
            "scenes in which what should stay was moved": np.concatenate(
                [end.disturbed for end in ends]
            ),
        }
        rows = []
        values: dict[str, float] = {}
        for name, is_so in counts.items():
            share = wilson(int(is_so.sum()), len(is_so))
            values |= share.named(name.replace(" ", "_"))
            ends_of = f"[{100 * share.low:.0f}, {100 * share.high:.0f}]"
            rows.append([name, f"{100 * share.estimate:.1f} {ends_of}", len(is_so)])
        print_table(f"Tidied by {trained.config.name}", ["what", "%", "of"], rows)
        how = {"scenes": len(scenes), "places": self.places, "blind": self.blind}
        return how | values
