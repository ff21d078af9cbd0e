"""Claims about controls go in; the page "Does the knowledge matter?" comes out."""

from knowarm.report.blocks import Page, Text
from knowarm.report.claims import Claim, subject
from knowarm.report.pages.knowledge.controls import controls
from knowarm.report.pages.knowledge.elsewhere import elsewhere
from knowarm.report.pages.knowledge.parts import parts
from knowarm.report.study import Study
from knowarm.report.verdict import finding


def knowledge_page(study: Study, decided: list[Claim]) -> Page:
    """The knowledge agent against every control, as a whole and part by part."""
    page = Page(
        name="knowledge",
        short="Knowledge",
        title="Does the knowledge matter?",
        lead="Each control takes one thing away. The verdicts follow from the intervals below.",
    )
    for task in study.tasks:
        asked = subject(task)
        if asked is None or len(task.groups) < 2:
            continue
        mine = [c for c in decided if c.task is task and c.first is asked]
        page.add(
            task,
            [
                finding(task, decided, "success").verdict(),
                finding(task, decided, "speed").verdict(),
                *controls(task, asked, mine),
                *parts(task, asked, mine),
                *elsewhere(task, asked),
            ],
        )
    if page.blocks:
        page.blocks.insert(
            0,
            Text(
                paragraphs=[
                    "A vector that is the same in every episode carries no information about the "
                    "episode: to the network it is a bias. It can still change learning, by making "
                    "the network larger and by moving faster under the optimizer. So an advantage "
                    "over the baseline alone says nothing about knowledge; what counts is the "
                    "advantage over controls that differ in the knowledge and in nothing else."
                ]
            ),
        )
    return page
