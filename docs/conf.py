"""Sphinx configuration of the documentation site: `make docs`."""

import hashlib
from importlib.metadata import version as version_of
from pathlib import Path

project = "KnowArm"
author = "KnowArm contributors"
copyright = "KnowArm contributors, Apache-2.0"
version = release = version_of("knowarm")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
]
source_suffix = {".md": "myst-nb"}
exclude_patterns = ["_build", "results/[!b]*/**"]
myst_enable_extensions = ["colon_fence", "html_image"]
myst_heading_anchors = 4
suppress_warnings = ["myst.xref_missing"]  # scripts/check_site.py checks every link

# Notebooks run when the site is built; their output is kept until what they read changes.
READ = (
    "src/**/*.*",
    "docs/results/*.*",
    "docs/notebooks/*.py",
    "scripts/*.py",
    "zoo/**/*.*",
)
SOURCES = sorted(
    file
    for each in READ
    for file in Path(__file__).parents[1].glob(each)
    if file.is_file() and file.suffix != ".pyc"
)
DIGEST = hashlib.sha256(b"".join(path.read_bytes() for path in SOURCES)).hexdigest()[
    :12
]
nb_execution_mode = "cache"
nb_execution_cache_path = str(Path(__file__).parent / "_build" / f".notebooks-{DIGEST}")
nb_execution_timeout = -1
nb_execution_raise_on_error = True
nb_merge_streams = True
nb_ipywidgets_js = {}  # nothing from other servers
autosummary_generate = False
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
default_role = "code"
highlight_language = (
    "none"  # of blocks that name no language: commands and what they print
)
copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = False

html_theme = "sphinx_book_theme"
html_title = "KnowArm"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_js_files = ["site.js"]
html_search_scorer = str(Path(__file__).parent / "_static/scorer.js")
html_favicon = "_static/favicon.svg"
html_context = {"default_mode": "auto"}
html_theme_options = {
    "show_navbar_depth": 1,
    "show_toc_level": 2,
    "use_download_button": False,
    "navbar_persistent": [],
}


def write_llms_txt(app, exception):
    """Write llms.txt: title and address of every page, for language models."""
    if exception is None and app.builder.format == "html":
        titles = app.env.titles
        lines = [f"- [{titles[page].astext()}]({page}.html)" for page in sorted(titles)]
        text = "\n".join(
            ["# KnowArm", "", "> Commonsense for robot-arm policies.", "", *lines, ""]
        )
        (Path(app.outdir) / "llms.txt").write_text(text, encoding="utf-8")


def setup(app):
    """Register the hook."""
    app.connect("build-finished", write_llms_txt)
