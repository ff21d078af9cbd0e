"""A study goes in; one page for each question comes out."""

from knowarm.report.blocks import Page
from knowarm.report.claims import claims
from knowarm.report.pages.differences import differences_page
from knowarm.report.pages.films import films_page
from knowarm.report.pages.inputs import inputs_page
from knowarm.report.pages.joints import joints_page
from knowarm.report.pages.knowledge import knowledge_page
from knowarm.report.pages.paper import paper_page
from knowarm.report.pages.results import results_page
from knowarm.report.pages.runs import runs_page
from knowarm.report.pages.summary import summary_page
from knowarm.report.pages.training import training_page
from knowarm.report.study import Study


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
