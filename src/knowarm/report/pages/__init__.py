"""Pages of the report in reading order: names, headings and contents."""

from collections.abc import Callable, Sequence

from knowarm.report.blocks import Block, Page, Part, Text
from knowarm.report.choice import choice_findings
from knowarm.report.claims import claims
from knowarm.report.pages import (
    behaviour,
    differences,
    inputs,
    knowledge,
    paper,
    query,
    results,
    runs,
    summary,
    training,
)
from knowarm.report.study import Study, Task

HEADINGS = {
    "summary": ("Summary", "All sentences are generated from the intervals below."),
    "inputs": ("Network inputs", "All agents receive the same image and differ in the vector."),
    "training": ("Training", "Interim evaluations on fixed episodes, with training thresholds."),
    "results": ("Results", "The best model of every run on the same new episodes."),
    "query": ("Was the query understood?", "Agents that are told it, against their controls."),
    "knowledge": ("Does the knowledge matter?", "Each control lacks one property of the vector."),
    "differences": ("Are the differences significant?", "The unit is the training seed."),
    "paper": (
        "Comparison with the paper",
        "The paper trained one seed per agent, A3C, 70 M steps.",
    ),
    "joints": ("Joint angles", "All steps of the evaluation, of the best run of each agent."),
    "episodes": ("Episodes", "Agents on the same episode, in the images the policy received."),
    "runs": ("Runs and sources", "All numbers of this report are computed from these folders."),
}
"""Heading and lead of every page, in reading order."""


def build_pages(study: Study) -> list[Page]:
    """Build all pages that have something to show."""
    decided, understood = claims(study), choice_findings(study)

    def per_task(blocks: Callable[[Task], Sequence[Block]], *intro: str) -> list[Block]:
        found = [
            Part(name=t.name, title=t.title, blocks=b) for t in study.tasks if (b := blocks(t))
        ]
        return [Text(paragraphs=intro), *found] if found and intro else [*found]

    def of_knowledge(task: Task) -> list[Block]:
        return knowledge.knowledge_blocks(task, decided)

    def of_query(task: Task) -> list[Block]:
        return query.query_blocks(task, understood)

    def of_differences(task: Task) -> list[Block]:
        return differences.difference_blocks(task, decided)

    content: dict[str, Sequence[Block]] = {
        "summary": summary.summary_blocks(study, decided, understood),
        "inputs": per_task(inputs.input_blocks),
        "training": per_task(training.training_blocks),
        "results": per_task(results.result_blocks),
        "query": per_task(of_query, *query.EXPLANATION),
        "knowledge": per_task(of_knowledge, knowledge.EXPLANATION),
        "differences": per_task(of_differences, *differences.EXPLANATION),
        "paper": paper.paper_blocks(study),
        "joints": per_task(behaviour.joint_blocks),
        "episodes": per_task(behaviour.film_blocks),
        "runs": runs.run_blocks(study),
    }
    return [
        Page(name=name, title=title, lead=lead, blocks=content[name])
        for name, (title, lead) in HEADINGS.items()
        if content[name]
    ]
