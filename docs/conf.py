"""Sphinx configuration of the documentation site: `make docs`."""

from importlib.metadata import version as version_of
from pathlib import Path

project = "KnowArm"
author = "KnowArm contributors"
copyright = "KnowArm contributors, Apache-2.0"
version = release = version_of("knowarm")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build", "results/[!b]*/**"]
myst_enable_extensions = ["colon_fence", "html_image"]
myst_heading_anchors = 4
suppress_warnings = ["myst.xref_missing"]  # tests/test_docs.py checks every link
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
default_role = "code"
copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = False

html_theme = "sphinx_book_theme"
html_title = "KnowArm"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
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
        text = "\n".join(["# KnowArm", "", "> Commonsense for robot-arm policies.", "", *lines, ""])
        (Path(app.outdir) / "llms.txt").write_text(text, encoding="utf-8")


def setup(app):
    """Register the hook."""
    app.connect("build-finished", write_llms_txt)
