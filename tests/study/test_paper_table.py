"""The committed page of the paper's table is what its committed pack gives."""

import re
from pathlib import Path

import numpy as np
import pytest

from knowarm.report import write_report
from knowarm.study.driver import open_study
from knowarm.study.pack import unpack_study
from knowarm.study.status import study_status

RESULTS = Path(__file__).parent.parent.parent / "docs" / "results"
NUMBER = re.compile(r"\d+(?:\.\d+)?")


@pytest.mark.slow
def test_the_page_of_the_papers_table_is_made_from_its_pack(tmp_path, monkeypatch):
    out = unpack_study(RESULTS / "paper.tar.xz", tmp_path / "paper")
    states = [run.state for run in study_status(open_study(out), out)]
    assert "done" in states
    assert "failed" not in states
    monkeypatch.chdir(tmp_path)  # the page names the runs as its command did
    made = write_report([Path("paper")], Path("paper.html")).read_text(encoding="utf-8")
    committed = (RESULTS / "paper.html").read_text(encoding="utf-8")
    # Last digits may differ between processors.
    assert NUMBER.split(made) == NUMBER.split(committed), (
        "make the page again: docs/results"
    )
    numbers = [np.array(NUMBER.findall(page), float) for page in (made, committed)]
    np.testing.assert_allclose(*numbers, rtol=1e-3, atol=0.02)
