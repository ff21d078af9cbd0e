"""Sizes of tests: small ones in `make test`, full ones in `make test-thorough`."""

import itertools
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar
from unittest import mock

T = TypeVar("T")

IS_THOROUGH = bool(os.environ.get("KNOWARM_TESTS_THOROUGH"))


def thorough(small: T, full: T) -> T:
    """Return the size or the cases of a test: ``full`` in `make test-thorough`, else ``small``."""
    return full if IS_THOROUGH else small


def combinations(*axes: Sequence[Any]) -> list[tuple[Any, ...]]:
    """Return the product of axes; in `make test` as few of it as hold each value of each axis."""
    longest = max(map(len, axes))
    few = [tuple(axis[i % len(axis)] for axis in axes) for i in range(longest)]
    return thorough(few, list(itertools.product(*axes)))


def share(values: Iterable[T], number: int, of: int) -> list[T]:
    """Return all values; in `make test` those of one of ``of`` shares, which together hold all."""
    values = list(values)
    return thorough(values[number % of :: of], values)


@contextmanager
def without_forks() -> Iterator[None]:
    """Compute in this process what is fenced: a fork of a test process takes 30 to 60 ms.

    In `make test-thorough`, a fence is a fork here, too.
    """
    from knowarm.fence import Fence

    with mock.patch.object(Fence, "is_inside", not IS_THOROUGH):
        yield
