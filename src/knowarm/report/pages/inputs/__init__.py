"""Runs go in; the page that shows what the networks were given comes out."""

import json

from knowarm.report.blocks import Block, Page
from knowarm.report.pages.inputs.overview import constants, overview
from knowarm.report.pages.inputs.parameters import parameters
from knowarm.report.pages.inputs.told import told
from knowarm.report.pages.inputs.vector import knowledge
from knowarm.report.slug import slugs
from knowarm.report.study import Study, Task

MOST_IMAGES = 4
"""Different knowledge vectors that are drawn; all stand in the table."""


DRAWN_FIRST = ("full", "full+", "partial", "target")


def inputs_page(study: Study) -> Page:
    """The graph, the sentences, the vector, and how many parameters see it."""
    page = Page(
        name="inputs",
        short="Inputs",
        title="What went in",
        lead="The image is the same for all agents; they differ in what else they are told.",
    )
    for task in study.tasks:
        page.add(task, _task_blocks(task))
    return page


def _task_blocks(task: Task) -> list[Block]:
    shown = [(group.name, group.runs[0]) for group in task.groups if group.runs]
    blocks: list[Block] = [constants(task, shown), overview(task, shown)]
    stems = slugs(group.name for group in task.groups)
    drawn: set[str] = set()
    graphs: set[str] = set()
    for name, run in sorted(shown, key=lambda each: _rank(each[1].agent)):
        known = told(run)
        key = json.dumps(known.get("config", known), sort_keys=True)
        if not known.get("slots") or key in drawn or len(drawn) >= MOST_IMAGES:
            continue
        drawn.add(key)
        blocks += knowledge(name, f"{task.name}-{stems[name]}", run, known, graphs)
    return [*blocks, *parameters(task, shown)]


def _rank(agent: str) -> int:
    """Agents with knowledge come before controls, whose vectors copy theirs."""
    return DRAWN_FIRST.index(agent) if agent in DRAWN_FIRST else len(DRAWN_FIRST)
