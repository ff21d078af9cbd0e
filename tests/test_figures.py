"""The figures of the results: each shows the numbers of its page or table."""

import pytest

from scripts.draw_results import FIGURES, IMAGES, RESULTS, table

UNPACKED = [
    name
    for name, (sources, _) in FIGURES.items()
    if not any(source.endswith(".tar.xz") for source in sources)
]
"""Figures whose sources need no unpacking."""


@pytest.mark.parametrize("name", UNPACKED)
def test_a_figure_shows_the_numbers_of_its_source(name):
    sources, draw = FIGURES[name]
    drawn = draw(*(RESULTS / source for source in sources))
    stored = (IMAGES / name).read_text(encoding="utf-8")
    assert drawn.split("</style>")[1] == stored.split("</style>")[1]


def test_tables_of_a_page_are_read_without_markup(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "text\n\n| a | `b` |\n|---|---|\n| **1** | 2 [1, 3] % |\n\n| c |\n|---|\n| 4 |\n"
    )
    assert table(page, 0) == [["a", "b"], ["1", "2 [1, 3] %"]]
    assert table(page, 1) == [["c"], ["4"]]
