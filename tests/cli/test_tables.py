"""Tables at the width of a terminal: words stay whole, and names are no markup."""

import pytest
from rich.text import Text

from knowarm.cli.tables import UNLIMITED, make_console, print_table
from knowarm.experiment.logs import TrainingProgress

COLUMNS = [
    "experiment",
    "accuracy %",
    "success wide %",
    "return",
    "description of the experiment",
]
ROWS = [
    [
        "irb120-choose-subgraph-fast",
        "98.2 [97, 99]",
        "99.1 [98, 100]",
        12.5,
        "as long as a line",
    ],
    ["tiago-choose-query-onehot-fast", "8.2 [7, 9]", "9.1 [8, 10]", -3.25, "short"],
]
WORDS = {
    word for texts in [COLUMNS, *ROWS] for text in texts for word in str(text).split()
}


def printed(capsys, *table) -> list[str]:
    print_table(*table)
    return capsys.readouterr().out.splitlines()


@pytest.mark.parametrize("width", [60, 80, 100, 200])
def test_words_stay_whole_in_a_terminal(capsys, monkeypatch, width):
    monkeypatch.setenv("COLUMNS", str(width))
    title, *lines = printed(
        capsys, "A title that is longer than the table " * 3, COLUMNS, ROWS
    )
    assert title == "A title that is longer than the table " * 3
    assert max(map(len, lines)) <= width
    words = {word for line in lines for word in line.replace("┃", "│").split()}
    assert words >= (WORDS - {"-3.25"}) | {"-3.250"}
    # A table that is split has its first column in each part.
    tops = [line for line in lines if line.startswith("┏")]
    assert sum("irb120-choose-subgraph-fast" in line for line in lines) == len(tops)
    assert len(tops) == (1 if width > 60 else 2)


@pytest.mark.parametrize("width", [80, 100, 120])
def test_a_cell_that_may_not_wrap_stays_on_one_line(capsys, monkeypatch, width):
    monkeypatch.setenv("COLUMNS", str(width))
    cell = "100.0 [98.7, 100.0] %"
    names = [f"measure {i}" for i in range(6)]
    rows = [["irb120-choose-subgraph-fast", *[Text(cell, no_wrap=True)] * 6]]
    lines = printed(capsys, "title", ["experiment", *names], rows)
    assert sum(line.count(cell) for line in lines) == 6
    assert max(map(len, lines)) <= width


def test_a_table_in_a_pipe_is_as_wide_as_its_content(capsys, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    lines = printed(capsys, "title", ["a", "b"], [["x " * 150, "y"]])
    assert len(lines) == 6


def test_a_table_without_an_output_or_a_reader_is_no_traceback(monkeypatch):
    with monkeypatch.context() as closed:
        closed.setattr("sys.stdout", None)  # of ``>&-``
        closed.delenv("COLUMNS", raising=False)
        assert make_console().width == UNLIMITED
    with pytest.raises(BrokenPipeError):  # of ``| head -1``; `main` returns 0
        make_console().on_broken_pipe()


def test_names_are_no_markup(capsys):
    text = "\n".join(printed(capsys, "[bold]title[/]", ["[red]"], [["[/nonsense]"]]))
    assert all(each in text for each in ("[bold]title[/]", "[red]", "[/nonsense]"))


def test_names_do_not_act_on_the_terminal(capsys):
    text = "".join(
        printed(capsys, "\x1b]0;title\a", ["\x1b[31m"], [["\x1b[2J\r\u202eend"]])
    )
    assert text.isprintable()
    assert "\\x1b[2J\\r\\u202eend" in text


def test_names_are_no_markup_in_a_progress_bar(monkeypatch, capsys):
    monkeypatch.setenv("TTY_COMPATIBLE", "1")  # rich draws the bar as on a terminal
    with TrainingProgress("[/nonsense]", 10) as progress:
        progress.metrics({"step": 5})
    assert "[/nonsense]" in capsys.readouterr().err
