"""The check of the built site, and what it cannot see: blocks of code that nothing runs."""

import re
from importlib import import_module

from knowarm.experiment.algorithms import ALGORITHMS
from knowarm.study.config import read_study
from scripts.check_site import offenders
from scripts.figures import style
from tests.snippets.test_snippets import PAGES, PARTS, commands
from tests.source_tree import ROOT, files

LINE = re.compile(
    r"(?:\$ )?((?:knowarm|python|pip|pipx|uvx|make|docker|hf|sbatch|cd|git)\b.*)"
)
OUTSIDE = re.compile(
    r"(pip install|python -m venv|hf auth login|docker (build|run)|sbatch|uvx|pipx|cd |make )"
)
"""Commands that need an account, another machine or a fresh environment, so that no test runs them;
`.ci/check-wheel` and the workflow install from the wheel, tests/test_docs.py checks the targets."""

GOOD = '<h1 id="top">A</h1><a href="#top">up</a><img src="a.png" alt="a">'


def build(folder, page, other=GOOD):
    """Write a site of two pages and one image, without notebooks."""
    (folder / "site").mkdir()
    (folder / "site" / "a.png").write_bytes(b"")
    (folder / "site" / "index.html").write_text(page)
    (folder / "site" / "other.html").write_text(other)
    return folder / "site"


def test_a_site_in_order_has_no_offenders(tmp_path):
    page = f'{GOOD}<a href="other.html#top">b</a><a href="https://example.org">c</a>'
    assert list(offenders(build(tmp_path, page))) == []


def test_every_kind_of_offender_is_found(tmp_path):
    page = """<a href="gone.html">a</a><a href="other.html#gone">b</a><img src="a.png">
    <script src="https://example.org/a.js"></script>"""
    site = build(tmp_path, page)
    for folder in ("notebooks", "_sources/notebooks"):
        (site / folder).mkdir(parents=True)
    (site / "notebooks" / "reach.html").write_text(GOOD.replace("a.png", "../a.png"))
    (site / "_sources" / "notebooks" / "reach.md").write_text("")
    found = " ".join(offenders(site))
    for each in (
        "no file gone.html",
        "no heading other.html#gone",
        "without alternative text",
    ):
        assert each in found
    assert "loads https://example.org/a.js" in found
    assert "notebooks/reach.md: was not executed" in found


def test_a_folder_without_pages_is_no_site(tmp_path):
    assert list(offenders(tmp_path)) == [f"{tmp_path}: no pages"]


def unrun(page, text):
    """Yield the code and commands of a page that tests/snippets/test_snippets.py does not run."""
    mark = ""
    for kind, _, language, block in PARTS.findall(text):
        if not kind and mark not in ("skip", "file", "in"):
            run = (
                list(commands(block))
                if page in PAGES and language in ("", "sh")
                else []
            )
            lines = [
                f[1].strip()
                for f in map(LINE.match, re.sub(r"\\\n", " ", block).splitlines())
                if f
            ]
            if language == "python" and page not in PAGES:
                yield block.splitlines()[0]
            if language in ("", "sh", "bash", "console"):
                yield from (
                    each
                    for each in lines
                    if each not in run and not OUTSIDE.match(each)
                )
        mark = kind


def test_every_snippet_is_run_or_says_why_not():
    pages = files("docs", suffix=".md") | {
        "README.md": (ROOT / "README.md").read_text("utf-8")
    }
    found = [
        f"{page}: {line}"
        for page, text in pages.items()
        # Run by `make docs`
        if not page.startswith(("docs/lab-notes", "docs/notebooks"))
        for line in unrun(page, text)
    ]
    assert not found, "\n".join(found)


def test_a_snippet_that_nothing_runs_is_found():
    block = "```\nknowarm list\n```\n\n```python\nimport knowarm\n```\n"
    assert list(unrun("docs/decisions.md", block)) == ["knowarm list", "import knowarm"]
    assert list(
        unrun("docs/decisions.md", f"<!-- snippets: skip a reason -->\n{block}")
    ) == ["import knowarm"]
    assert list(unrun("README.md", block)) == []


def test_the_study_files_of_the_documentation_can_be_read(tmp_path, monkeypatch):
    # One names it
    monkeypatch.syspath_prepend(str(ROOT / "examples" / "own_algorithm"))
    monkeypatch.setitem(ALGORITHMS, "a2c", import_module("a2c").A2C)
    studies = [
        block
        for text in files("docs", suffix=".md").values()
        for _, _, language, block in PARTS.findall(text)
        if language == "toml" and re.search(r"^seeds =", block, re.MULTILINE)
    ]
    assert studies
    for number, block in enumerate(studies):
        path = tmp_path / f"{number}.toml"
        path.write_text(block, "utf-8")
        read_study(path)


def test_figures_embed_the_style_of_drawings_only():
    rules = style()
    for each in ("--ink:", ".c-blue", ".c-faint", "svg text", ".tick", ".line"):
        assert each in rules
    for each in ("dark", ".verdict", "th, td", ".film"):
        assert each not in rules
