"""Report: one self-contained HTML page about the runs of a study, with its numbers as files."""

from knowarm.report.write import report
from knowarm.report.write import report as write_report

__all__ = ["report", "write_report"]
