"""Report: one self-contained HTML page about the runs of a study, with its numbers as files."""

from knowarm.report.write import write_report

__all__ = ["write_report"]
