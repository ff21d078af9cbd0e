"""Mutations: all fit the current source, and some are executed (``make mutate`` executes all)."""

import ast
from pathlib import Path

import pytest

from tests.mutate import ROOT, copy_tree, is_caught, mutated
from tests.mutations import MUTATIONS

EXECUTED = ("20 degrees for 17", "no lower clip bound", "a success has a future")


def test_there_are_at_least_forty_different_ones():
    assert len(MUTATIONS) == len({mutation.name for mutation in MUTATIONS}) >= 40


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.name)
def test_every_mutation_fits_the_source_and_names_tests(mutation):
    text = mutated(mutation)
    if mutation.file.endswith(".py"):
        ast.parse(text)
    path, _, rest = mutation.tests.partition(" ")
    file, _, test = path.partition("::")
    words = rest.removeprefix("-k ") if rest else test
    assert words in (ROOT / file).read_text()


@pytest.mark.slow
def test_some_mutations_are_caught(tmp_path: Path):
    copy_tree(tmp_path)
    for mutation in MUTATIONS:
        if mutation.name in EXECUTED:
            assert is_caught(mutation, tmp_path), mutation.name
