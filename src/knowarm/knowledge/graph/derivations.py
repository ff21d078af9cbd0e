"""What derived triples of a graph follow from."""

from collections.abc import Iterator

import numpy as np

Ids = np.ndarray
"""Ids of entities or relations, or numbers of triples."""
_IdTriple = tuple[int, int, int]
"""Head, relation and tail by id."""


class Derivations:
    """The steps of a closure: what each derived triple follows from.

    Attributes:
        triples: ids of heads, relations and tails by step, (s, 3) int32; -1 where a step is no
            triple of the graph, but one on the way to others.
        premises: numbers of the steps that each follows from, (s, 4) int32; -1 is none.
        derived: the steps that are the derived triples, (n,) int64, sorted by triple.
    """

    def __init__(self, triples: Ids, premises: Ids, derived: Ids) -> None:
        self.triples = triples
        self.premises = premises
        self._size = int(triples.max(initial=0)) + 1
        keys = self._keys(triples[derived])
        order = np.argsort(keys)
        self.derived = derived[order]
        self._sorted_keys = keys[order]

    def __len__(self) -> int:
        return len(self.derived)

    def is_derived(self, triples: Ids) -> Ids:
        """Return whether each of some triples (n, 3) was derived, (n,) bool."""
        return np.isin(self._keys(triples), self._sorted_keys)

    def because(self, triple: _IdTriple) -> list[_IdTriple]:
        """Return the triples that a derived one follows from; none of a stated one."""
        step = self._step(triple)
        if step is None:
            return []
        reasons = list[_IdTriple]()
        for premise in self._told(step):
            head, relation, tail = self.triples[premise].tolist()
            if (head, relation, tail) not in reasons:
                reasons.append((head, relation, tail))
        # "a teapot is a pot" is read before "a pot is a dish"
        return sorted(reasons, key=lambda reason: reason[0] != triple[0])

    def _told(self, step: int) -> Iterator[int]:
        """Yield the nearest steps before one that are triples of the graph."""
        waiting = self._before(step)
        while waiting:
            premise = waiting.pop()
            if self.triples[premise, 0] >= 0:
                yield premise
            else:
                waiting += self._before(premise)

    def _before(self, step: int) -> list[int]:
        """Return the premises of a step, the last one first."""
        return [
            premise for premise in self.premises[step, ::-1].tolist() if premise >= 0
        ]

    def _step(self, triple: _IdTriple) -> int | None:
        key = self._keys(np.array([triple]))[0]
        place = int(np.searchsorted(self._sorted_keys, key))
        if place < len(self) and self._sorted_keys[place] == key:
            return int(self.derived[place])
        return None

    def _keys(self, triples: Ids) -> Ids:
        heads, relations, tails = triples.T.astype(np.int64)
        return (relations * self._size + heads) * self._size + tails
