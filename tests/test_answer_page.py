"""The page on the paper's claim follows from the packs, and README's answer from the page."""

import html
import re
from functools import cache
from pathlib import Path

import pytest

from knowarm.experiment.summary import Summary
from knowarm.report import write_report
from knowarm.study.pack import unpack_study
from scripts.build_answer import main

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "results" / "answer.md"
PAGES = [
    PAGE.with_stem(f"answer{end}")
    for end in ("", "-cells", "-size", "-a3c", "-fusions")
]
MOST_LETTERS = 8_000
"""Letters of a page of the answer or of the lab notes; longer ones become several pages."""
TABLES = [
    PAGE.with_name(f"{name}.csv")
    for name in ("answer-runs", "answer-comparisons", "a3c-changes")
]
CELLS = [
    f"{robot}, {colours} colours"
    for robot in ("IRB120", "TIAGo")
    for colours in ("fixed", "randomized")
]
NUMBERS = ("four", "five", "six", "seven", "eight", "nine", "ten")


@pytest.mark.slow(8)
def test_the_page_is_what_the_packs_say(tmp_path, monkeypatch):
    """Summaries are read once each: pages and counts of runs share them."""
    monkeypatch.setattr(Summary, "read", cache(Summary.read))
    out = tmp_path / "answer.md"
    monkeypatch.setattr("sys.argv", ["build_answer", "--out", str(out)])
    main()
    for file in (*PAGES, *TABLES):
        assert out.with_name(file.name).read_text("utf-8") == file.read_text("utf-8")


def test_answer_and_lab_notes_are_pages_and_no_scrolls():
    notes = sorted((ROOT / "docs" / "lab-notes").glob("*.md"))
    assert len(notes) > 9
    for page in (*PAGES, *notes, ROOT / "docs" / "lab-notes.md"):
        assert len(page.read_text("utf-8")) < MOST_LETTERS, page.name
    assert "hidden" not in (ROOT / "docs/_static/site.js").read_text("utf-8")


def agents_of(cell):
    """Return the seeds and the success of each agent from the table of a cell."""
    section = PAGES[1].read_text("utf-8").split(f"\n## {cell}\n")[1].split("\n## ")[0]
    rows = re.findall(r"^\| `(.+?)` \| (\d+) \| .+? \| (.+?) \|", section, re.M)
    return {name: (int(seeds), success) for name, seeds, success in rows}


def test_readme_has_the_answer_of_the_page():
    readme = (ROOT / "README.md").read_text("utf-8")
    fewest = min(
        agents_of(cell)[agent][0] for cell in CELLS for agent in ("bm", "full")
    )
    assert f"with {NUMBERS[fewest - 4]} seeds or more, no effect" in readme
    paper = PAGE.with_name("paper.md").read_text("utf-8").split("\n## ")[0]
    claims = re.findall(r"^\| .+ \| .+ \| .+ \| (.+) \|$", paper, re.M)[1:7]
    assert all(verdict.startswith("not found") for verdict in claims), claims
    top = " ".join(PAGE.read_text("utf-8").split("\n## ")[0].split())
    bounds = [
        int(each) for each in re.findall(r"excludes a saving of more than (\d+) %", top)
    ]
    assert len(bounds) == len(CELLS)
    said = f"of the four cells exclude that it saves more than {min(bounds)} to {max(bounds)} %"
    assert said in " ".join(readme.split())


CLAIMANTS = ("README.md", "docs/faq.md", "docs/notebooks/knowledge.md")
"""Files that say what is found in reaching; each such paragraph carries the keys of findings."""
KEY = re.compile(r"<!-- finding: (.+?); (.+?); (.+?) -->\n")
CLAIM = re.compile(
    r"no (effect|advantage)|learns? faster|better than the (paper's )?baseline|higher .*than the"
)
SAME_SENTENCE = r"(?:[^.]|\.\d)*"
WORDING = {
    "no advantage over the baseline is shown": (
        "no (effect|advantage)",
        "{outcome}",
        "found",
    ),
    "better than the baseline, but not than a network as large": (
        *("(better|higher|faster)", "baseline", "not than a network as large"),
    ),
}
"""What a paragraph must say, by the finding that the page states."""


def findings_of_the_page() -> dict[tuple[str, ...], tuple[str, str]]:
    """Return difference and finding by cell, agent and outcome."""
    section = PAGE.read_text("utf-8").split("\n## All outcomes\n")[1].split("\n## ")[0]
    row = r"^\| (.+?) \| `(.+?)` \| (\w.+?) \| (.+?) \| .+? \| (.+) \|$"
    rows = re.findall(row, section, re.M)
    return {tuple(key): (difference, finding) for *key, difference, finding in rows}


@pytest.mark.parametrize("file", CLAIMANTS)
def test_claims_say_what_the_report_of_the_packs_finds(file):
    found, keyed = findings_of_the_page(), 0
    assert len(found) == 8
    for paragraph in (ROOT / file).read_text("utf-8").split("\n\n"):
        keys, text = KEY.findall(paragraph), " ".join(KEY.sub("", paragraph).split())
        assert keys or not CLAIM.search(text) or "`bm`" in text, (
            f"a claim without a key: {text}"
        )
        keyed += len(keys)
        if keys and {cell for cell, *_ in keys} != {*CELLS}:
            for robot, colours in (cell.split(", ") for cell, *_ in keys):
                named = robot in text and colours in text
                assert named, f"found on {robot}, {colours}, and {file} says: {text}"
        for key in keys:
            difference, finding = found[key]
            wording = SAME_SENTENCE.join(WORDING[finding]).replace("{outcome}", key[2])
            assert re.search(wording, text), (
                f"{key} is {finding!r}, and {file} says: {text}"
            )
            for given in re.findall(r"\(([+-][\d.]+) points \[(.+?)\]", text):
                assert (
                    difference
                    == f"{given[0]} [{', '.join(f'+{n}' for n in given[1].split(', '))}]"
                )
    assert keyed


@pytest.mark.slow(20)
@pytest.mark.parametrize("pack", ["answer", "answer-tiago"])
def test_page_and_report_of_a_pack_have_one_value_per_comparison(pack, tmp_path):
    study = unpack_study(PAGE.with_name(f"{pack}.tar.xz"), tmp_path / pack)
    report = write_report([study], tmp_path / "report.html")
    text = html.unescape(re.sub(r"<[^>]+>", "", report.read_text("utf-8")))
    section = PAGE.read_text("utf-8").split("\n## All outcomes\n")[1].split("\n## ")[0]
    robot = "TIAGo" if "tiago" in pack else "IRB120"
    row = rf"^\| {robot}, .+? \| `full` \| \w.+? \| .+? \| (\S+) \| "
    rows = re.findall(row, section, re.M)[: 4 if pack == "answer" else 2]
    found = re.findall(
        r"full against bm: .+?, adjusted p (?:= )?(<? ?\.?[\d.]+)\)", text
    )
    assert {*rows} == {each.strip() for each in found}
