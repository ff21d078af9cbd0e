"""The short forms of the campaigns of mutations and file errors; `make torture` runs long ones."""

import pytest

from tests.robustness.edges import clocks, forged_rows, links, sockets
from tests.robustness.faults import inject_file_errors
from tests.robustness.formats import make_formats, try_mutations
from tests.thorough import thorough

MUTATIONS = range(thorough(2, 5))
"""Of each format, by seed."""


@pytest.mark.slow
def test_damaged_files_end_in_an_error_for_users(tmp_path):
    failures = [
        f for each in make_formats(tmp_path) for f in try_mutations(each, MUTATIONS)
    ]
    assert failures == []


@pytest.mark.slow
def test_file_errors_end_in_an_error_for_users_and_leave_what_was_stored():
    errors = thorough(12, 30)
    assert inject_file_errors(errors, 0) == (errors, [])


@pytest.mark.slow
@pytest.mark.parametrize("campaign", [clocks, forged_rows, links, sockets])
def test_the_edges_keep_what_they_promise(campaign, short_handshakes):
    assert campaign(20, 0) == (20, [])
