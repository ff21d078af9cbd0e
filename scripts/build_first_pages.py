"""Build the pages to look at before installing: an answered question, and a report.

python -m scripts.build_first_pages    # writes to docs/_static, which the site's first page links
"""

import argparse
import re
import tempfile
from pathlib import Path

from knowarm.cli.main import main as knowarm
from knowarm.report import write_report
from knowarm.study.pack import unpack_study

ROOT = Path(__file__).parents[1]
PAGES = ROOT / "docs" / "_static"
QUESTION = "something to drink from"
STUDY = ROOT / "docs" / "results" / "answer-tiago.tar.xz"
AGENTS = ("bm", "full")
"""Agents of the report: all of the study would make it twice as large."""
FILES = re.compile(r"<a [^>]* download>.*?</a>")
"""Links to CSV files, which are not published."""
RUNS = re.compile(r'<a [^>]*href="(?!#|https?:)[^"]*"[^>]*>(.*?)</a>')
"""Links to run folders, which are not published either."""


def main() -> None:
    """Write both pages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=PAGES)
    out = parser.parse_args().out
    knowarm(["ask", QUESTION, "--page", str(out / "answer.html")])
    with tempfile.TemporaryDirectory() as name:
        study = unpack_study(STUDY, Path(name) / "answer-tiago")
        runs = [study / f"tiago-{agent}-fast" for agent in AGENTS]
        report = write_report(runs, Path(name) / "report.html")
        text = FILES.sub("", report.read_text(encoding="utf-8"))
        text = RUNS.sub(r"\1", text)
        (out / "report.html").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
