"""Report: one self-contained HTML page about the runs of a study; its figures and tables alone."""

from knowarm.report.figure import write_figure
from knowarm.report.write import write_report

__all__ = ["write_figure", "write_report"]
