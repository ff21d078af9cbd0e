"""A study goes in; one page for each question comes out."""

from knowarm.experiment.report.blocks import Page
from knowarm.experiment.report.claims import claims
from knowarm.experiment.report.pages.differences import differences_page
from knowarm.experiment.report.pages.films import films_page
from knowarm.experiment.report.pages.inputs import inputs_page
from knowarm.experiment.report.pages.joints import joints_page
from knowarm.experiment.report.pages.knowledge import knowledge_page
from knowarm.experiment.report.pages.paper import paper_page
from knowarm.experiment.report.pages.results import results_page
from knowarm.experiment.report.pages.runs import runs_page
from knowarm.experiment.report.pages.summary import summary_page
from knowarm.experiment.report.pages.training import training_page
from knowarm.experiment.report.study import Study


def build_pages(study: Study) -> list[Page]:
    """All pages that have something to show, summary first."""
    decided = claims(study)
    pages = [
        summary_page(study, decided),
        inputs_page(study),
        training_page(study),
        results_page(study),
        knowledge_page(study, decided),
        differences_page(study, decided),
        paper_page(study),
        joints_page(study),
        films_page(study),
        runs_page(study),
    ]
    return [page for page in pages if page.blocks]
