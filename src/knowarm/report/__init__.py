"""Run folders go in; one self-contained page, its JSON and its CSVs come out."""

from knowarm.report.write import report
from knowarm.report.write import report as write_report

__all__ = ["report", "write_report"]
