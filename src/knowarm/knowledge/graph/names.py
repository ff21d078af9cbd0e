"""Names of a graph by number, and what they are found by: spellings, last parts and labels."""

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cached_property
from typing import SupportsIndex

from knowarm.errors import UserError
from knowarm.knowledge.graph.terms import local_name, name_key

_Index = defaultdict[str, list[int]]
"""Ids by what the names are found by."""


class Names(tuple[str, ...]):
    """Sorted distinct names; the id of a name is its rank in the order of code points."""

    def find(self, name: str) -> int | None:
        """Return the id of a name, or None: a binary search."""
        index = bisect_left(self, name)
        if index < len(self) and self[index] == name:
            return index
        return None

    def at(self, ids: Iterable[SupportsIndex]) -> list[str]:
        """Return the names of ids."""
        return list(map(self.__getitem__, ids))

    def find_local(self, local: str) -> list[int]:
        """Return the ids of the names, but for literals, whose `local_name` this is, ascending."""
        return self._by_local.get(local, [])

    def find_literals(self, text: str) -> list[int]:
        """Return the ids of the literals of this text, in any case, ascending."""
        return self._literals.get(text.casefold(), [])

    def short(self, index: int) -> str:
        """Return the last part of a name, or the whole where several have the same."""
        name = self[index]
        local = local_name(name)
        return name if len(self.find_local(local)) > 1 else local

    @cached_property
    def blank(self) -> frozenset[str]:
        """The names of blank nodes, which stand beside each other."""
        return frozenset(self[bisect_left(self, "_:") : bisect_left(self, "_;")])

    @cached_property
    def _by_local(self) -> _Index:
        ids = _Index(list)
        for index, name in enumerate(self):
            if not name.startswith('"'):
                ids[local_name(name)].append(index)
        return ids

    @cached_property
    def _literals(self) -> _Index:
        ids = _Index(list)
        for index, name in enumerate(self):
            if name.startswith('"'):
                ids[local_name(name).casefold()].append(index)
        return ids


class AmbiguousNameError(UserError):
    """A name that several entities or relations have."""


class Spellings:
    """Finds names that are written otherwise, or by their labels."""

    def __init__(self, names: Names, labels: Mapping[str, str]) -> None:
        self.names = names
        self.labels = labels

    def find(self, name: str, kind: str, counts: Callable[[int], bool]) -> int | None:
        """Return the id of a name, its last part, its label or another spelling; None without.

        Raises:
            AmbiguousNameError: several ids that count are found alike.
        """
        exact = self.names.find(name)
        if exact is not None and counts(exact):
            return exact
        for candidates in self.alike(name):
            ids = list(filter(counts, candidates))
            if len(ids) > 1:
                full = ", ".join(self.names.at(ids[:5]))
                raise AmbiguousNameError(
                    f"{name!r} names {len(ids)} {kind} of the graph: {full}. "
                    f"Give the full name of one of them."
                )
            if ids:
                return ids[0]
        return None

    def near(self, name: str) -> list[str]:
        """Return the last parts of names that end with a name ("CoffeeMug"), shortest first."""
        wanted = name_key(name)
        ids = set[int]()
        for key, with_key in self._by_key.items():
            if key.endswith(wanted):
                ids.update(with_key)
        nearby = sorted(map(self.names.short, ids))
        return sorted(nearby, key=len)

    def alike(self, name: str) -> Iterator[list[int]]:
        """Yield the ids of last part, of label and of spelling."""
        yield self.names.find_local(name)
        yield self._by_label.get(name, [])
        yield self._by_key.get(name_key(name), [])

    @cached_property
    def _by_label(self) -> _Index:
        ids = _Index(list)
        for name, label in self.labels.items():
            index = self.names.find(name)
            if index is not None:
                ids[label].append(index)
        return ids

    @cached_property
    def _by_key(self) -> _Index:
        ids = _Index(list)
        for index, name in enumerate(self.names):
            if name.startswith(('"', "_:")):
                continue
            label = self.labels.get(name, name)
            for key in {name_key(local_name(name)), name_key(label)}:
                ids[key].append(index)
        return ids
