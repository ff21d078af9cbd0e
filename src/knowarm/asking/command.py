"""``knowarm ask`` and ``answer``: questions to a trained agent, and to a graph alone."""

import re
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from knowarm.asking.answers import answer
from knowarm.asking.asker import Asker
from knowarm.asking.outcome import Asked, in_words
from knowarm.asking.page import make_server, serve_page, write_page
from knowarm.cli.arguments import read_names
from knowarm.cli.knowledge.options import ObjectOptions
from knowarm.cli.tables import FilePath, TableCommand, print_meeting, print_table
from knowarm.errors import UserError, printable, shell_command
from knowarm.experiment.load import load_agent
from knowarm.experiment.other_graphs import meeting
from knowarm.experiment.zoo import PACKAGED
from knowarm.knowledge.formats import read_graph
from knowarm.knowledge.graph.homonyms import object_ids
from knowarm.perception.config import LEVEL, Unclear
from knowarm.questions import ObjectColour

SHOWN = 12  # most objects whose evidence is printed


@dataclass(frozen=True, kw_only=True)
class Ask(TableCommand):
    """Ask a trained agent: the graph answers, the network finds the answer, the arm goes there."""

    agent: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="[RUN]")] = ""
    """A run of the choose task with a grounding network, e.g. zoo/irb120-choose-answers-fast.
    Default: the policy that the package holds."""
    question: Annotated[
        tyro.conf.Positional[str], tyro.conf.arg(metavar="[QUESTION]")
    ] = ""
    """In plain words, "something to drink from that is not blue"; in conditions, "usedFor drinking
    and not hasColor blue", "usedFor (relatedTo tea)", "count hasPart >= 3"; or SPARQL that selects
    ?object; of an agent that sorts also with a destination, "put the mug on the blue tray".
    Optional with --browser."""
    graph: str | None = None
    """Path of another graph, or the name of a shipped one; default: the run's."""
    format: str | None = None
    """The format of that graph, as of `knowarm knowledge`; by default recognized."""
    names: tuple[str, ...] = ()
    """The graph's names for objects, such as mug=CoffeeMug wine_glass=Q81707, or a file of such
    lines; spelling (wine_glass, WineGlass, wine glasses) makes no difference."""
    edit: tuple[str, ...] = ()
    """Changes of the graph, such as "- mug usedFor drinking" "+ lamp usedFor drinking". The scene
    is then one with another answer than without them, unless --scene is given."""
    scene: int | None = None
    """Number of the scene; default: of the first 60 in which exactly one object answers the first
    whose objects stand apart, whose answer the network sees, and which the arm reaches; if there is
    none, the first."""
    seed: int = 0
    """Seed of the scenes."""
    unclear: Unclear = "seen"
    """If the network sees no answer, or several: move to the most likely place ("guess"), do so if
    it sees any ("seen"), stay ("stop"), or ask which one is meant ("ask")."""
    level: float = LEVEL
    """How often the object that is meant shall be among those that count as answers; calibrated on
    images that training did not see."""
    page: FilePath = None
    """Write an HTML page with answers, evidence, map of places and film."""
    browser: bool = False
    """Open a page in the browser on which questions and edits can be changed; Ctrl-C ends it."""
    port: int = 0
    """Port of that page, which only this machine can reach; 0 takes the first free one from
    8080."""

    def result(self) -> dict[str, Any]:
        """Answer, play, and print or show."""
        run = self.agent
        question = self.question
        if not question and not _is_path(run):
            question = run
            run = PACKAGED
        if not question and not self.browser:
            words = filter(None, (self.agent, "something to drink from"))
            where = ""
            if self.edit or self.names:
                where = ", before --edit and --names, which take every word after them"
            raise UserError(f"Give a question{where}: {shell_command('ask', *words)}")
        if self.browser and self.page is not None:
            raise UserError(
                "--browser serves a page and writes none: leave out --page."
            )
        trained = load_agent(run)
        graph = None
        if self.graph:
            graph = read_graph(self.graph, self.format)
        names = read_names(self.names)
        asking = (question, self.edit, self.scene, self.unclear)
        asker = Asker(trained, graph, seed=self.seed, names=names, level=self.level)
        with closing(asker):
            if graph is not None:
                print_meeting(meeting(graph, [name for name, _ in asker.facets], names))
            if self.browser:
                serve_page(make_server(asker, *asking, port=self.port))
                return {}
            asked = asker.ask(*asking)
            _print(asked)
            if self.unclear == "ask" and asked.stopped:
                picked = _pick(asked.candidates or asked.named)
                if picked is not None:
                    answers = asked.answers
                    where = asked.where
                    asked = asker.play(answers, asked.scene, picked=picked, where=where)
                    print(printable(asked.outcome))
        if self.page is not None:
            write_page(Path(self.page), asked, question, self.edit)
            print(f"Wrote {self.page}")
        end = asked.film[-1]
        evidence = asked.answers.evidence
        return {
            "question": asked.answers.question,
            "where": asked.where,
            "left_out": list(asked.answers.left_out),
            "answers": {"/".join(facet): list(evidence[facet]) for facet in evidence},
            "scene": asked.scene,
            "selection": asked.selection,
            "shown": list(map("/".join, asked.shown)),
            "named": list(map("/".join, asked.named)),
            "candidates": list(map("/".join, asked.candidates)),
            "reached": "/".join(asked.reached),
            "right": asked.right,
            "success": end.success,
            "steps": end.step,
        }


def _is_path(word: str) -> bool:
    """Return whether a word is a run and no question: a folder, or what looks like a path."""
    if re.fullmatch(r"[^\s/\\]*[/\\]\S*", word):
        return True
    is_folder = False
    with suppress(OSError):  # a question too long for a path
        is_folder = word != "" and Path(word).is_dir()
    return is_folder


def _pick(choices: Sequence[ObjectColour]) -> ObjectColour | None:
    """Ask the user which object is meant; None if no number of one is given."""
    by_number = {}
    for number, facet in enumerate(choices, 1):
        print(f"  {number}: the {in_words(facet)}")
        by_number[str(number)] = facet
    with suppress(EOFError):
        typed = input("Which one is meant? Its number, or nothing to stay: ").strip()
        return by_number.get(typed)
    return None


def _print(asked: Asked) -> None:
    """Print the answers with their evidence, the scene and what the arm did."""
    lines = asked.table
    columns = ["object", "colours", "evidence"]
    print(printable(f"I read this as: {asked.as_read}"))
    print_table("Answers in the graph", columns, lines[:SHOWN])
    if len(lines) > SHOWN:
        print(f"and {len(lines) - SHOWN} more.")
    _print_facets(asked, "stand", asked.shown)
    named = sorted(asked.named, key=[*asked.shown, *asked.named].index)
    _print_facets(asked, "the network names", named)
    print(printable(asked.outcome))
    if asked.selection:
        print(f"{asked.selection} --scene N plays another.")


def _print_facets(asked: Asked, verb: str, facets: Sequence[ObjectColour]) -> None:
    """Print what stands in the scene or is named there, with what answers and what is wrong."""
    marked = []
    for facet in facets:
        text = in_words(facet)
        if facet in asked.answers.evidence:
            text += " (answers)"
        if facet not in asked.shown:
            text += " (a mistake)"
        marked.append(text)
    print(printable(f"In scene {asked.scene} {verb}: {', '.join(marked)}."))


@dataclass(frozen=True, kw_only=True)
class AnswerCommand(ObjectOptions, TableCommand):
    """Answer a question about objects by a graph alone, without an agent."""

    question: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="QUESTION")]
    """In plain words, in conditions, or in SPARQL, as of `knowarm ask`."""

    def result(self) -> dict[str, Any]:
        """Answer, and print the objects that answer."""
        graph = self.read()
        facets = self.facets(graph)
        names = {}
        if not self.objects:  # they are of the graph, whatever they are
            shown = dict.fromkeys(name for name, _ in facets)
            entities = object_ids(graph, shown)
            names = dict(zip(shown, graph.names.at(entities), strict=True))
        answers = answer(graph, facets, self.question, names)
        objects = [*answers.evidence]
        print_table(f"Answers to: {answers.as_read}", ["object", "colour"], objects)
        return {"query": answers.question, "answers": objects}
