"""Runs and claims go in; the page on which differences are real, and how large, comes out."""

from knowarm.report.blocks import Page, Text
from knowarm.report.claims import ALPHA, FEWEST_SEEDS, Claim
from knowarm.report.pages.differences.comparisons import comparisons
from knowarm.report.pages.differences.networks import networks
from knowarm.report.pages.differences.profiles import profiles
from knowarm.report.pages.differences.scores import scores_table
from knowarm.report.pages.differences.thresholds import thresholds
from knowarm.report.pages.differences.variance import variance
from knowarm.report.study import Study

EXPLANATION = (
    "A method is a recipe for training networks; the unit of its evidence is a training seed. "
    "A thousand evaluation episodes describe one network very exactly and say nothing about the "
    "next one the same recipe would train.",
    "Two outcomes are decided on: success after training and mean success during training. Means "
    "are compared by Welch's t over training seeds. First the knowledge agent is compared with the "
    "baseline, with Holm's correction over all tasks and outcomes of the report; only where that "
    "shows a real difference are the controls asked, and a question is settled only when every "
    f"control of its kind is beaten. Real means: an adjusted p of at most {ALPHA}, and "
    f"{FEWEST_SEEDS} seeds of each agent or more. In studies without any effect at most one in "
    "twenty reports claims one.",
    "Everything else on this page is described, not tested: interquartile means, bootstrap "
    "intervals (too narrow below some ten seeds), the probability that one run beats another, "
    "steps to a level of success.",
)


def differences_page(study: Study, decided: list[Claim]) -> Page:
    """The statistics over training seeds, and the paper's, each with what it shows."""
    page = Page(
        name="differences",
        short="Differences",
        title="Are the differences real?",
        lead="Training seeds are the unit; the paper's own test stands at the end.",
        blocks=[Text(paragraphs=EXPLANATION)],
    )
    for task in study.tasks:
        if len(task.groups) < 2:
            continue
        mine = [claim for claim in decided if claim.task is task]
        found = [
            comparisons(task, mine),
            scores_table(task),
            profiles(task),
            thresholds(task),
            networks(task),
            variance(task),
        ]
        page.add(task, [block for blocks in found for block in blocks])
    return page
