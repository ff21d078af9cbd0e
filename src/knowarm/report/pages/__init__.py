"""Pages of the report in reading order: names, headings and contents."""

from collections.abc import Callable, Sequence

from knowarm.report.blocks import Block, Page, Part, Text
from knowarm.report.claims import claims
from knowarm.report.format import counted
from knowarm.report.pages import (
    behaviour,
    differences,
    inputs,
    knowledge,
    paper,
    results,
    runs,
    summary,
    training,
)
from knowarm.report.study import Study, Task


def build_pages(study: Study) -> list[Page]:
    """Build all pages that have something to show, summary first."""
    decided = claims(study)

    def per_task(blocks: Callable[[Task], Sequence[Block]], *intro: str) -> list[Block]:
        found = [
            Part(name=t.name, title=t.title, blocks=b) for t in study.tasks if (b := blocks(t))
        ]
        return [Text(paragraphs=intro), *found] if found and intro else [*found]

    size = f"{counted(len(study.runs), 'training run')}, {counted(len(study.tasks), 'task')}"
    pages = [
        Page(
            name="summary",
            title="Summary",
            lead=f"{size}. All sentences are generated from the intervals below.",
            blocks=summary.summary_blocks(study, decided),
        ),
        Page(
            name="inputs",
            title="Network inputs",
            lead="All agents receive the same image; they differ in the knowledge vector.",
            blocks=per_task(inputs.input_blocks),
        ),
        Page(
            name="training",
            title="Training",
            lead="Interim evaluations on the same fixed episodes, with the thresholds of training.",
            blocks=per_task(training.training_blocks),
        ),
        Page(
            name="results",
            title="Evaluation after training",
            lead="The best model of every run on the same fixed episodes, disjoint from training.",
            blocks=per_task(results.result_blocks),
        ),
        Page(
            name="knowledge",
            title="Does the knowledge matter?",
            lead="Each control lacks one property of the knowledge vector.",
            blocks=per_task(
                lambda task: knowledge.knowledge_blocks(task, decided), knowledge.EXPLANATION
            ),
        ),
        Page(
            name="differences",
            title="Are the differences significant?",
            lead="The unit is the training seed; the paper's own test is at the end.",
            blocks=per_task(
                lambda task: differences.difference_blocks(task, decided), *differences.EXPLANATION
            ),
        ),
        Page(
            name="paper",
            title="Comparison with the paper",
            lead="Published numbers: one training seed per agent, A3C, 70 M steps.",
            blocks=paper.paper_blocks(study),
        ),
        Page(
            name="joints",
            title="Joint angles",
            lead="Angles at every step of the evaluation, of the best run of each agent.",
            blocks=per_task(behaviour.joint_blocks),
        ),
        Page(
            name="episodes",
            title="Episodes",
            lead="Agents on the same episode, in the images that the policy received.",
            blocks=per_task(behaviour.film_blocks),
        ),
        Page(
            name="runs",
            title="Runs and sources",
            lead="All numbers of this report are computed from these folders.",
            blocks=runs.run_blocks(study),
        ),
    ]
    return [page for page in pages if page.blocks]
