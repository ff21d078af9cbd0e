import pytest

from tests.tiny import FACETS


@pytest.fixture
def facets() -> list[tuple[str, str]]:
    """The task's six facets (colours randomized)."""
    return list(FACETS)


@pytest.fixture
def fixed_facets() -> list[tuple[str, str]]:
    """The task's three facets (colours fixed)."""
    return FACETS[::2]
