"""Names of a graph by number, and what they are found by: spellings, last parts and labels."""

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property

from knowarm.errors import UserError
from knowarm.knowledge.graph.terms import local_name, name_key


class Names(tuple[str, ...]):
    """Sorted distinct names; the id of a name is its rank in the order of code points."""

    def find(self, name: str) -> int | None:
        """Return the id of a name, or None: a binary search."""
        index = bisect_left(self, name)
        return index if index < len(self) and self[index] == name else None

    def find_local(self, local: str) -> list[int]:
        """Return the ids of the names, but for literals, whose `local_name` this is, ascending."""
        return self._by_local[False].get(local, [])

    def find_literals(self, text: str) -> list[int]:
        """Return the ids of the literals of this text, in any case, ascending."""
        return self._by_local[True].get(text.casefold(), [])

    def short(self, index: int) -> str:
        """Return the last part of a name, or the whole where several have the same."""
        local = local_name(self[index])
        return local if len(self.find_local(local)) < 2 else self[index]

    @cached_property
    def _by_local(self) -> tuple[dict[str, list[int]], dict[str, list[int]]]:
        ids = defaultdict[str, list[int]](list), defaultdict[str, list[int]](list)
        for index, name in enumerate(self):
            is_literal, local = name.startswith('"'), local_name(name)
            ids[is_literal][local.casefold() if is_literal else local].append(index)
        return dict(ids[False]), dict(ids[True])


class AmbiguousNameError(UserError):
    """A name that several entities or relations have."""


class Spellings:
    """Finds names that are written otherwise, or by their labels."""

    def __init__(self, names: Names, labels: Mapping[str, str]) -> None:
        self.names, self.labels = names, labels

    def find(self, name: str, kind: str, among: Callable[[int], bool]) -> int | None:
        """Return the id of a name, its last part, its label or another spelling; None without.

        Raises:
            AmbiguousNameError: several ids ``among`` those that count are found alike.
        """
        exact = self.names.find(name)
        if exact is not None and among(exact):
            return exact
        for ids in self.alike(name):
            found = [i for i in ids if among(i)]
            if len(found) > 1:
                full = ", ".join(self.names[i] for i in found[:5])
                raise AmbiguousNameError(
                    f"{name!r} names {len(found)} {kind} of the graph: {full}. "
                    f"Give the full name of one of them."
                )
            if found:
                return found[0]
        return None

    def near(self, name: str) -> list[str]:
        """Return the last parts of names that end with a name ("CoffeeMug"), shortest first."""
        key = name_key(name)
        ids = {i for each, found in self._by_key.items() if each.endswith(key) for i in found}
        return sorted((self.names.short(i) for i in ids), key=lambda n: (len(n), n))

    def alike(self, name: str) -> Iterator[list[int]]:
        """Yield the ids of last part, of label and of spelling."""
        yield self.names.find_local(name)
        if self.labels:
            yield self._by_label.get(name, [])
        yield self._by_key.get(name_key(name), [])

    @cached_property
    def _by_label(self) -> dict[str, list[int]]:
        ids = defaultdict[str, list[int]](list)
        for name, label in self.labels.items():
            if (index := self.names.find(name)) is not None:
                ids[label].append(index)
        return dict(ids)

    @cached_property
    def _by_key(self) -> dict[str, list[int]]:
        ids = defaultdict[str, list[int]](list)
        for index, name in enumerate(self.names):
            if not name.startswith(('"', "_:")):
                for key in {
                    name_key(text) for text in (local_name(name), self.labels.get(name, name))
                }:
                    ids[key].append(index)
        return dict(ids)
