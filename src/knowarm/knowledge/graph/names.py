"""Names of a graph by number, and what they are found by: spellings, last parts and labels."""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import chain
from typing import SupportsIndex

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.graph.terms import (
    is_iri,
    label_of,
    letters_of,
    local_name,
    name_key,
)

Counts = Callable[[int], bool]
"""Whether an id counts."""


class Names(tuple[str, ...]):
    """Sorted distinct names; the id of a name is its rank in the order of code points."""

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self.find(name) is not None

    def find(self, name: str) -> int | None:
        """Return the id of a name, or None: a binary search."""
        index = bisect_left(self, name)
        if index < len(self) and self[index] == name:
            return index
        return None

    def find_all(self, names: Iterable[str]) -> list[int]:
        """Return the ids of those names that are here."""
        return [index for index in map(self.find, names) if index is not None]

    def at(self, ids: Iterable[SupportsIndex]) -> list[str]:
        """Return the names of ids."""
        return list(map(self.__getitem__, ids))

    def beginning_with(self, begin: str) -> range:
        """Return the ids of the names with a begin, which stand beside each other."""
        after = begin[:-1] + chr(ord(begin[-1]) + 1)
        return range(bisect_left(self, begin), bisect_left(self, after))

    def find_local(self, local: str) -> list[int]:
        """Return the ids of the names, but for literals, whose `local_name` this is, ascending."""
        return self.by_local[local]

    def find_beginning(self, word: str) -> list[int]:
        """Return the ids of the names, but for literals, whose last part begins with a word.

        Case and separators make no difference, nor does a bracket.
        """
        if word in self._beginning:
            return self._beginning[word]
        text, starts = self._letters
        wanted = f"\0{letters_of(word)}"
        ids = []
        start = text.find(wanted)
        while start >= 0:
            row = int(np.searchsorted(starts, start))
            ids.append(self.by_local.ids[row])
            start = text.find(wanted, start + 1)
        self._beginning[word] = ids
        return ids

    def find_literals(self, text: str) -> list[int]:
        """Return the ids of the literals of this text, in any case, ascending."""
        return self._by_text[text.casefold()]

    def short(self, index: int) -> str:
        """Return the last part of a name, or the whole where several have the same."""
        name = self[index]
        local = local_name(name)
        return name if len(self.find_local(local)) > 1 else local

    @property
    def blank(self) -> range:
        """The ids of blank nodes."""
        return self.beginning_with("_:")

    @cached_property
    def literals(self) -> range:
        """The ids of literals."""
        return self.beginning_with('"')

    @cached_property
    def by_local(self) -> "Index":
        """The ids of the names, but for literals, by `local_name`."""
        begin = self.literals.start
        end = self.literals.stop
        names = (*self[:begin], *self[end:])
        ids = [*range(begin), *range(end, len(self))]
        return Index(list(map(local_name, names)), ids)

    @cached_property
    def _beginning(self) -> dict[str, list[int]]:
        """What `find_beginning` found, by the word."""
        return {}

    # One text to search: a key for each of a million names would take seconds.
    @cached_property
    def _letters(self) -> tuple[str, np.ndarray]:
        """The letters of the texts of `by_local`, a zero byte before each, and where, (n,)."""
        letters = letters_of("\0" + "\0".join(self.by_local.texts))
        letters = letters.replace("\0<", "\0")  # as of "<mug> (3)"
        lengths = list(map(len, letters.split("\0")))
        return letters, np.cumsum(lengths[:-1]) + np.arange(len(lengths) - 1)

    @cached_property
    def _by_text(self) -> "Index":
        texts = map(local_name, self.at(self.literals))
        return Index(list(map(str.casefold, texts)), self.literals)


class Index:
    """Ids by text. Sorted hashes are made in a third of the time that a list per text takes.

    Attributes:
        texts: what the ids are found by, n, in any order; the same may stand there twice.
        ids: the id of each text, n.
    """

    def __init__(self, texts: Sequence[str], ids: Sequence[int]) -> None:
        self.texts = texts
        self.ids = ids
        hashes = np.fromiter(map(hash, texts), np.int64, len(texts))
        self._order = np.argsort(hashes, kind="stable")
        self._sorted = hashes[self._order]

    def __getitem__(self, text: str) -> list[int]:
        """Return the ids of a text, ascending."""
        wanted = hash(text)
        # For one text faster than searchsorted
        low = bisect_left(self._sorted, wanted)
        high = bisect_right(self._sorted, wanted, low)
        ids = set()
        for row in self._order[low:high]:
            if self.texts[row] == text:
                ids.add(self.ids[row])
        return sorted(ids)


class AmbiguousNameError(UserError):
    """A name that several entities or relations have."""


def several(name: str, kind: str, full: Sequence[str]) -> AmbiguousNameError:
    """Return the error of a name that several of a kind have, with their full names."""
    return AmbiguousNameError(
        f"{name!r} names {len(full)} {kind} of the graph: {', '.join(full[:5])}. "
        f"Give the full name of one of them."
    )


class Spellings:
    """Finds names that are written otherwise, or by their labels."""

    def __init__(self, names: Names, labels: Mapping[str, str]) -> None:
        self.names = names
        self.labels = labels

    def find(self, name: str, kind: str, counts: Counts) -> int | None:
        """Return the id of a name, its last part, its label or another spelling; None without.

        Raises:
            AmbiguousNameError: several ids that count are found alike.
        """
        for candidates in chain([self.names.find_all([name])], self.alike(name)):
            ids = list(filter(counts, candidates))
            if len(ids) > 1:
                raise several(name, kind, self.names.at(ids))
            if ids:
                return ids[0]
        return None

    def same_name(self, name: str, counts: Counts) -> list[int]:
        """Return the ids that count of one name, ascending.

        They have its letters, in any case and with any separators, or its label; where none has it
        as its name, last part or label, they have one spelling in common, such as the plural.
        """
        by_local, by_label, alike = self.alike(name)
        ids = {*by_local, *by_label, *self.names.find_all([name])}
        if any(map(counts, ids)):
            letters = letters_of(local_name(name))
            for index in alike:
                local = local_name(self.names[index])
                if letters_of(local) == letters:
                    ids.add(index)
        else:
            ids.update(alike)
        return sorted(filter(counts, ids))

    def near(self, name: str) -> list[str]:
        """Return the last parts of names that end with a name ("CoffeeMug"), shortest first."""
        wanted = name_key(name)
        ids = set()
        for index, key in zip(self._by_key.ids, self._by_key.texts, strict=True):
            words = label_of(self.names[index], self.labels).split()
            # Whole words: Japan is no pan
            ends = {name_key("".join(words[start:])) for start in range(len(words))}
            if key.endswith(wanted) and wanted in ends:
                ids.add(index)
        nearby = sorted(map(self.names.short, ids))
        return sorted(nearby, key=len)

    def alike(self, name: str) -> Iterator[list[int]]:
        """Yield the ids of last part, of label and of spelling."""
        yield self.names.find_local(name)
        yield self._by_label[name]
        key = name_key(name)
        ids = set(self._by_key[key])
        if is_iri(name):
            for index in self._by_key[name_key(local_name(name))]:
                if name_key(self.names[index]) == key:
                    ids.add(index)
        yield sorted(ids)

    @cached_property
    def _labelled(self) -> dict[int, str]:
        """The label by id."""
        labels = {}
        for name, label in self.labels.items():
            for index in self.names.find_all([name]):
                labels[index] = label
        return labels

    @cached_property
    def _by_label(self) -> Index:
        return Index(list(self._labelled.values()), list(self._labelled))

    @cached_property
    def _by_key(self) -> Index:
        ids = []
        keys = []
        blank = self.names.blank
        literals = self.names.literals
        by_local = self.names.by_local
        named = zip(by_local.ids, by_local.texts, strict=True)
        for index, text in chain(named, self._labelled.items()):
            if index not in blank and index not in literals:
                ids.append(index)
                keys.append(name_key(text))
        return Index(keys, ids)
