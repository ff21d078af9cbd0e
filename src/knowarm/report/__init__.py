"""Run folders go in; one self-contained page, its JSON and its CSVs come out."""

from knowarm.report.write import report

__all__ = ["report"]
