"""Pages of the report in reading order: names, headings and contents."""

from collections.abc import Callable, Sequence
from typing import Any

from knowarm.report.blocks import Block, Page, TaskPart, Text
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

    pages = (
        Page(
            "summary",
            "Summary",
            "All sentences are generated from the intervals below.",
            runs.summary_blocks(study, decided, understood),
        ),
        Page(
            "inputs",
            "Network inputs",
            "All agents receive the same image and differ in the vector.",
            per_task(inputs.input_blocks),
        ),
        Page(
            "training",
            "Training",
            "Interim evaluations on fixed episodes, with training thresholds.",
            per_task(training.training_blocks),
        ),
        Page(
            "results",
            "Results",
            "The best model of every run on the same new episodes.",
            per_task(results.result_blocks),
        ),
        Page(
            "query",
            "Was the query understood?",
            "Agents that receive it, against their controls.",
            per_task(query.query_blocks, understood, intro=query.EXPLANATION),
        ),
        Page(
            "knowledge",
            "Does the knowledge matter?",
            "Each control lacks one property of the vector.",
            per_task(knowledge.knowledge_blocks, decided, intro=knowledge.EXPLANATION),
        ),
        Page(
            "differences",
            "Are the differences significant?",
            "The unit is the training seed.",
            per_task(
                differences.difference_blocks, decided, intro=differences.EXPLANATION
            ),
        ),
        Page(
            "paper",
            "Comparison with the paper",
            "Published: one seed per agent, A3C, 70 M steps.",
            paper.paper_blocks(study),
        ),
        Page(
            "joints",
            "Joint angles",
            "All steps of the evaluation, of the best run of each agent.",
            per_task(behaviour.joint_blocks),
        ),
        Page(
            "episodes",
            "Episodes",
            "Agents on the same episode, in the images the policy received.",
            per_task(behaviour.film_blocks),
        ),
        Page(
            "runs",
            "Runs and sources",
            "All numbers of this report are computed from these folders.",
            runs.run_blocks(study),
        ),
    )
    return [page for page in pages if page.blocks]
