"""Pages of the report in reading order: names, headings and contents."""

from collections.abc import Callable, Sequence
from typing import Any

from knowarm.report.blocks import TABLES, Block, Page, TaskPart, Text
from knowarm.report.model import StudyData
from knowarm.report.pages import (
    behaviour,
    differences,
    inputs,
    knowledge,
    paper,
    query,
    results,
    runs,
    training,
)
from knowarm.report.verdicts.claims import claims
from knowarm.report.verdicts.query import query_findings


def build_pages(study: StudyData) -> list[Page]:
    """Build all pages that have something to show, in reading order."""
    decided = claims(study)
    understood = query_findings(study)

    def per_task(
        task_blocks: Callable[..., Sequence[Block]],
        *more: Any,
        intro: Sequence[str] = (),
    ) -> list[Block]:
        parts: list[Block] = []
        for task in study.tasks:
            blocks = task_blocks(task, *more)
            if blocks:
                parts.append(TaskPart(name=task.name, title=task.title, blocks=blocks))
        if parts and intro:
            parts.insert(0, Text(intro))
        return parts

    contents = {
        "summary": runs.summary_blocks(study, decided, understood),
        "inputs": per_task(inputs.input_blocks),
        "training": per_task(training.training_blocks),
        "results": per_task(results.result_blocks),
        "query": per_task(query.query_blocks, understood, intro=query.EXPLANATION),
        "knowledge": per_task(
            knowledge.knowledge_blocks, decided, intro=knowledge.EXPLANATION
        ),
        "differences": per_task(
            differences.difference_blocks, decided, intro=differences.EXPLANATION
        ),
        "paper": paper.paper_blocks(study),
        "joints": per_task(behaviour.joint_blocks),
        "episodes": per_task(behaviour.film_blocks),
        "runs": runs.run_blocks(study),
    }
    pages = []
    for name, blocks in contents.items():
        if blocks:
            pages.append(Page(name, **TABLES["pages"][name], blocks=blocks))
    return pages
