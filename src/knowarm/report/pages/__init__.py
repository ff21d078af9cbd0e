"""Pages of the report in reading order: names, headings and contents."""

from collections.abc import Callable, Sequence

from knowarm.report.blocks import Block, Page, Part, Text
from knowarm.report.claims import claims
from knowarm.report.format import counted
from knowarm.report.pages.behaviour import film_blocks, joint_blocks
from knowarm.report.pages.differences import EXPLANATION as TESTS
from knowarm.report.pages.differences import difference_blocks
from knowarm.report.pages.inputs import input_blocks
from knowarm.report.pages.knowledge import EXPLANATION as CONTROLS
from knowarm.report.pages.knowledge import knowledge_blocks
from knowarm.report.pages.paper import paper_blocks
from knowarm.report.pages.results import result_blocks
from knowarm.report.pages.runs import run_blocks
from knowarm.report.pages.summary import summary_blocks
from knowarm.report.pages.training import training_blocks
from knowarm.report.study import Study, Task


def build_pages(study: Study) -> list[Page]:
    """Build all pages that have something to show, summary first."""
    decided = claims(study)

    def per_task(blocks: Callable[[Task], Sequence[Block]], *intro: str) -> list[Block]:
        found = [
            Part(name=t.name, title=t.title, blocks=b) for t in study.tasks if (b := blocks(t))
        ]
        return [Text(paragraphs=intro), *found] if found and intro else [*found]

    runs, tasks = counted(len(study.runs), "training run"), counted(len(study.tasks), "task")
    pages = [
        Page(
            name="summary",
            short="Summary",
            title="Summary",
            lead=f"{runs}, {tasks}. All sentences are generated from the intervals below.",
            blocks=summary_blocks(study, decided),
        ),
        Page(
            name="inputs",
            short="Inputs",
            title="Network inputs",
            lead="All agents receive the same image; they differ in the knowledge vector.",
            blocks=per_task(input_blocks),
        ),
        Page(
            name="training",
            short="Training",
            title="Training",
            lead="Interim evaluations on the same fixed episodes, with the thresholds of training.",
            blocks=per_task(training_blocks),
        ),
        Page(
            name="results",
            short="Results",
            title="Evaluation after training",
            lead="The best model of every run on the same fixed episodes, disjoint from training.",
            blocks=per_task(result_blocks),
        ),
        Page(
            name="knowledge",
            short="Knowledge",
            title="Does the knowledge matter?",
            lead="Each control lacks one property of the knowledge vector.",
            blocks=per_task(lambda task: knowledge_blocks(task, decided), CONTROLS),
        ),
        Page(
            name="differences",
            short="Differences",
            title="Are the differences significant?",
            lead="The unit is the training seed; the paper's own test is at the end.",
            blocks=per_task(lambda task: difference_blocks(task, decided), *TESTS),
        ),
        Page(
            name="paper",
            short="Paper",
            title="Comparison with the paper",
            lead="Published numbers: one training seed per agent, A3C, 70 M steps.",
            blocks=paper_blocks(study),
        ),
        Page(
            name="joints",
            short="Joints",
            title="Joint angles",
            lead="Angles at every step of the evaluation, of the best run of each agent.",
            blocks=per_task(joint_blocks),
        ),
        Page(
            name="films",
            short="Episodes",
            title="Episodes",
            lead="Agents on the same episode, in the images that the policy received.",
            blocks=per_task(film_blocks),
        ),
        Page(
            name="runs",
            short="Runs",
            title="Runs and sources",
            lead="All numbers of this report are computed from these folders.",
            blocks=run_blocks(study),
        ),
    ]
    return [page for page in pages if page.blocks]
