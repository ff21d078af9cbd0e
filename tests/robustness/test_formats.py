"""The short form of the mutation campaign; `make torture` runs the long one."""

import pytest

from tests.robustness.formats import make_formats, try_mutations

TRIES = 5
"""Mutations of each format."""


@pytest.fixture(scope="module")
def formats(tmp_path_factory):
    return make_formats(tmp_path_factory.mktemp("formats"))


@pytest.mark.slow
def test_damaged_files_end_in_an_error_for_users(formats):
    failures = [f for each in formats for f in try_mutations(each, range(TRIES))]
    assert failures == []
