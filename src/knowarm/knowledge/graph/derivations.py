"""What derived triples of a graph follow from."""

from collections.abc import Iterable

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
        derived: the steps that are the derived triples, (n,) int64, sorted by relation,
            head and tail.
    """

    def __init__(self, triples: Ids, premises: Ids, derived: Ids) -> None:
        self.triples = triples
        self.premises = premises
        self.derived = derived
        self._size = int(triples.max(initial=0)) + 1
        self._sorted_keys = self._keys(triples[derived])

    def is_derived(self, triples: Ids) -> Ids:
        """Return whether each of some triples (n, 3) was derived, (n,) bool."""
        return np.isin(self._keys(triples), self._sorted_keys)

    def because(self, triple: _IdTriple) -> list[_IdTriple]:
        """Return the triples that a derived one follows from; none of a stated one."""
        (key,) = self._keys(np.array([triple]))
        low, high = np.searchsorted(self._sorted_keys, [key, key + 1])
        start = self.derived[low:high].tolist()
        waiting = list(start)
        reasons = dict[_IdTriple, None]()
        while waiting:
            step = waiting.pop()
            head, relation, tail = self.triples[step].tolist()
            if step not in start and head >= 0:
                reasons[head, relation, tail] = None
                continue
            # No triple of the graph: what is before it
            premises = self.premises[step, ::-1]
            waiting += premises[premises >= 0].tolist()
        # "a teapot is a pot" is read before "a pot is a dish"
        return sorted(reasons, key=lambda reason: reason[0] != triple[0])

    def _keys(self, triples: Ids) -> Ids:
        heads, relations, tails = triples.T
        return mixed([relations, heads, tails], self._size)


def mixed(columns: Iterable[Ids], size: int, count: int = 1) -> Ids:
    """Return one number for the ids below ``size`` of several columns, (n,) int64.

    Of no columns these are ``count`` zeros.
    """
    keys = np.zeros(count, np.int64)
    for column in columns:
        keys = keys * size + column
    return keys
