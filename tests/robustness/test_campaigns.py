"""Short forms of the campaigns against tables, names and interrupts."""

import pytest

from tests.robustness.cells import damage_cells
from tests.robustness.interrupts import interrupt, long_commands
from tests.robustness.names import print_names


@pytest.mark.slow
def test_damaged_cells_are_named_and_other_runs_go_on():
    assert damage_cells(8, 0) == (8, [])


@pytest.mark.slow
def test_names_are_printed_as_text():
    assert print_names(3, 0) == (3, [])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["RDF/XML", "N-Triples", "SPARQL"])
def test_ctrl_c_ends_long_work_in_one_line(tmp_path, name):
    commands = long_commands(tmp_path, triples=1_000_000)
    assert interrupt(commands[name], tmp_path, after_s=2) is None
