"""Rules over triples: joins of integer arrays that remember what each new triple follows from."""

from collections.abc import Iterable, Mapping, Sequence
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from knowarm.knowledge.graph.derivations import Ids, mixed

MOST = 5_000_000
"""Most triples that may follow, and most rows of a join."""
MOST_ROUNDS = 300
"""Most rounds: the longest way along one relation."""
PREMISES = 4
"""Most triples from which one follows in one step."""
_Atom = tuple[str, str, str]
"""Subject, relation and object: a variable ("?x") or the word of a constant."""
COLUMNS = (
    "subject",
    "relation",
    "object",
)
_ORDER = (
    "relation",
    "subject",
    "object",
)
"""Columns in the order by which steps are sorted."""
Table = dict[str, Ids]
"""Columns of equal length by name. A step is a triple of ids and what it follows from:

- subject, relation, object: ids, (n,) int32;
- confidence: probability that it holds, (n,) float32;
- premises: numbers of other steps, (n, 4) int32; -1 is none;
- unnamed: how many of these are about parts of axioms, (n,) int8;
- is_single: whether it does not follow by a rule with brackets, (n,) bool;
- key, number: one number per triple, and per step, (n,) int64.
"""


class TooManyError(Exception):
    """More follows than `MOST`."""


class Rule(NamedTuple):
    """What follows if all atoms of a body hold."""

    body: tuple[_Atom, ...]
    head: _Atom
    single: _Atom | None
    """The atom of the body that holds of single steps alone, so that each way is gone once."""


def read_rules(text: str) -> list[Rule]:
    """Read one rule per line: ``?x type ?c, ?c subClassOf ?d -> ?x type ?d``.

    An atom in brackets, ``[?c subClassOf ?d]``, holds of single steps: of what does not follow by a
    rule with brackets.
    """
    rules = []
    for line in filter(None, map(str.strip, text.splitlines())):
        left, _, right = line.partition(" -> ")
        single = None
        body = []
        for text_of_atom in left.split(", "):
            atom = _atom(text_of_atom.strip("[]"))
            body.append(atom)
            if text_of_atom.startswith("["):
                single = atom
        rules.append(Rule(tuple(body), _atom(right), single))
    return rules


def _atom(text: str) -> _Atom:
    subject, relation, value = text.split()
    return subject, relation, value


def steps_of(triples: Ids, confidence: Ids | None = None) -> Table:
    """Return triples of ids (n, 3) as steps that follow from nothing."""
    count = len(triples)
    steps = dict(zip(COLUMNS, triples.T.astype(np.int32), strict=True))
    steps["confidence"] = np.ones(count, np.float32)
    if confidence is not None:
        steps["confidence"] = confidence.astype(np.float32)
    steps["premises"] = np.full((count, PREMISES), -1, np.int32)
    steps["unnamed"] = np.zeros(count, np.int8)
    steps["is_single"] = np.ones(count, bool)
    return steps


def _rows(table: Table, rows: Ids) -> Table:
    """Return some rows of a table, (k,) int or (n,) bool."""
    return {name: column[rows] for name, column in table.items()}


def _stacked(tables: Sequence[Table]) -> Table:
    """Return the rows of several tables of the same columns."""
    stacked = Table()
    for name in tables[0]:
        stacked[name] = np.concatenate([table[name] for table in tables])
    return stacked


class StepBatch:
    """Steps sorted by relation, subject and object, indexed as they are searched.

    Attributes:
        steps: the steps.
    """

    def __init__(self, steps: Table, size: int) -> None:
        """Take steps of ids below a size."""
        self.steps = steps
        self._size = size
        self._indices: dict[tuple[str, ...], tuple[Ids, Ids]] = {}
        self._parts: dict[tuple[tuple[int, ...] | None, bool], StepBatch] = {}

    def __len__(self) -> int:
        return len(self.steps["key"])

    def part(
        self, relations: tuple[int, ...] | None, *, only_single: bool = False
    ) -> "StepBatch":
        """Return the steps of some relations, or of all, and of these only the single ones."""
        key = (relations, only_single)
        if key == (None, False):
            return self
        if key not in self._parts:
            steps = self.steps
            if only_single:
                steps = _rows(steps, steps["is_single"])
            if relations is not None:
                steps = _rows(steps, np.isin(steps["relation"], relations))
            self._parts[key] = StepBatch(steps, self._size)
        return self._parts[key]

    def with_(self, other: "StepBatch") -> "StepBatch":
        """Return the steps of both."""
        steps = _stacked([self.steps, other.steps])
        order = np.lexsort((-steps["confidence"], steps["key"]))
        return StepBatch(_rows(steps, order), self._size)

    def match(self, bound: Mapping[str, Ids], most: int) -> tuple[Ids, Ids]:
        """Return the pairs (number of the row, place of the step) that agree.

        Args:
            bound: what stands in some of the columns, by column, each (n,) int.
            most: most pairs.

        Raises:
            TooManyError: there are more.
        """
        columns = tuple(sorted(bound, key=_ORDER.index))
        if columns not in self._indices:
            keys = mixed(map(self.steps.__getitem__, columns), self._size, len(self))
            order = np.argsort(keys, kind="stable")
            self._indices[columns] = keys[order], order
        keys, order = self._indices[columns]
        wanted = mixed(map(bound.__getitem__, columns), self._size)
        low = np.searchsorted(keys, wanted)
        counts = np.searchsorted(keys, wanted, side="right") - low
        total = int(counts.sum())
        if total > most:
            raise TooManyError
        rows = np.repeat(np.arange(len(wanted)), counts)
        starts = low - (np.cumsum(counts) - counts)
        return rows, order[np.arange(total) + starts[rows]]

    def confidence_of(self, keys: Ids) -> Ids:
        """Return the confidence of triples by their keys, (n,) float32; -1 of others."""
        if not len(self):
            return np.full(len(keys), -1, np.float32)
        known = self.steps["key"]
        places = np.searchsorted(known, keys).clip(max=len(self) - 1)
        is_here = known[places] == keys
        return np.where(is_here, self.steps["confidence"][places], np.float32(-1))


_START: Table = {
    "confidence": np.ones(1, np.float32),
    "premises": np.empty((1, 0), np.int32),
    "unnamed": np.zeros(1, np.int8),
}
"""The row that all joins begin with: rows of ids by variable, and what follows from premises."""
_NOTHING = steps_of(np.empty((0, 3)))
_HIERARCHIES = (
    "subClassOf",
    "subPropertyOf",
    "sameAs",
)
"""Relations that everything has to itself, which says nothing."""


class Reasoner:
    """Triples of ids, and all that follows by rules, round by round.

    Attributes:
        batches: what was stated, what was added, and what followed in each round.
    """

    def __init__(
        self,
        relations: int,
        is_literal: Ids,
        is_part: Ids,
        constants: Mapping[str, int],
    ) -> None:
        """Set up for ids, of which those below ``relations`` are relations.

        Args:
            relations: number of relations.
            is_literal: whether each id is a literal, (size,) bool.
            is_part: whether each id is a part of an axiom, (size,) bool.
            constants: ids of the words in rules.
        """
        self.batches = list[StepBatch]()
        self._size = len(is_literal)
        self._relations = relations
        self._is_literal = is_literal
        self._is_part = is_part
        self._constants = constants
        self._hierarchies = [constants[word] for word in _HIERARCHIES]
        self._only_named = False
        self._most_rows = MOST
        self._allowed: dict[Rule, dict[str, tuple[int, ...]]] = {}

    def add(self, steps: Table) -> StepBatch:
        """Give new steps their keys and add them.

        Of equal triples the surest stays, with the fewest unnamed premises.
        """
        steps["key"] = self._keys(steps)
        order = np.lexsort((steps["unnamed"], -steps["confidence"], steps["key"]))
        is_first = np.diff(steps["key"][order], prepend=-1) > 0
        steps = _rows(steps, order[is_first])
        steps["unnamed"] = self._is_about_parts(steps).astype(np.int8)
        steps["number"] = self.count + np.arange(len(steps["key"]))
        batch = StepBatch(steps, self._size)
        self.batches.append(batch)
        self._allowed.clear()
        # Few large batches are searched faster than many small ones.
        while len(self.batches) > 2:
            *_, previous, last = self.batches
            if len(previous) >= 2 * len(last):
                break
            self.batches[-2:] = [previous.with_(last)]
        return batch

    @property
    def count(self) -> int:
        """Number of all steps."""
        return sum(map(len, self.batches))

    def everything(self) -> Table:
        """Return all steps in the order of their numbers."""
        steps = _stacked([batch.steps for batch in self.batches])
        return _rows(steps, np.argsort(steps["number"]))

    def run(
        self, rules: Sequence[Rule], most: int, *, only_named: bool = False
    ) -> None:
        """Add all that follows, or nothing if it is too much.

        Args:
            rules: the rules.
            most: most triples that are added.
            only_named: leave out what is about parts of axioms.

        Raises:
            TooManyError: it is more.
        """
        before = list(self.batches)
        self._only_named = only_named
        self._most_rows = min(MOST, 10 * most)
        self._allowed.clear()
        try:
            self._run(rules, self.count + most)
        except TooManyError:
            self.batches = before
            raise

    def _run(self, rules: Sequence[Rule], most: int) -> None:
        new = list(self.batches)
        orders = 1  # all is new, so that one order of the atoms finds everything
        for _ in range(MOST_ROUNDS):
            results = []
            for rule in rules:
                starts = range(len(rule.body))
                for start in starts[:orders]:
                    result = self._apply(rule, start, new)
                    results.append(result)
            orders = PREMISES
            steps = _stacked(results)
            if not len(steps["unnamed"]):
                return
            new = [self.add(steps)]
            if self.count > most:
                break
        raise TooManyError

    def _apply(self, rule: Rule, start: int, new: Sequence[StepBatch]) -> Table:
        """Return the steps that follow by a rule if one atom of its body is among the new ones."""
        atoms = list(rule.body)
        table = self._join(_START, rule, atoms.pop(start), new)
        while atoms and len(table["confidence"]):
            known = [len(table.keys() & set(atom)) for atom in atoms]
            atom = atoms.pop(known.index(max(known)))
            table = self._join(table, rule, atom, self.batches)
        if not len(table["confidence"]):
            return _NOTHING
        bound = self._bound(table, rule.head)
        triples = np.stack([bound[column] for column in COLUMNS], axis=1)
        steps = steps_of(triples, table["confidence"])
        steps["premises"][:, : len(rule.body)] = table["premises"]
        steps["unnamed"] = table["unnamed"]
        steps["is_single"][:] = rule.single is None
        return _rows(steps, self._is_new(steps))

    def _bound(self, table: Table, atom: _Atom) -> dict[str, Ids]:
        """Return what is known of the columns of an atom, each (n,) int."""
        columns = {}
        for column, term in zip(COLUMNS, atom, strict=True):
            if term in table:
                columns[column] = table[term]
            elif not term.startswith("?"):
                count = len(table["confidence"])
                columns[column] = np.full(count, self._constants[term])
        return columns

    def _relations_of(self, rule: Rule) -> dict[str, tuple[int, ...]]:
        """Return the relations that axioms allow, by variable, as far as they restrict it."""
        if rule in self._allowed:
            return self._allowed[rule]
        allowed = {}
        relations = set(map(itemgetter(1), rule.body))
        for atom in rule.body:
            if atom[1].startswith("?"):
                continue
            key = (self._constants[atom[1]],)
            for column, term in (("subject", atom[0]), ("object", atom[2])):
                if term in relations and term.startswith("?"):
                    ids = set[int]()
                    for batch in self.batches:
                        ids.update(batch.part(key).steps[column].tolist())
                    allowed[term] = tuple(sorted(ids))
        self._allowed[rule] = allowed
        return allowed

    def _join(
        self, table: Table, rule: Rule, atom: _Atom, batches: Iterable[StepBatch]
    ) -> Table:
        """Return the rows of a table with all steps that agree with an atom of a rule."""
        bound = self._bound(table, atom)
        relations = self._relations_of(rule).get(atom[1])
        tables = []
        for batch in batches:
            part = batch.part(relations, only_single=atom == rule.single)
            rows, places = part.match(bound, self._most_rows)
            joined = _rows(table, rows)
            for column, term in zip(COLUMNS, atom, strict=True):
                if term.startswith("?") and term not in table:
                    joined[term] = part.steps[column][places]
            numbers = part.steps["number"][places]
            joined["premises"] = np.column_stack([joined["premises"], numbers])
            joined["confidence"] *= part.steps["confidence"][places]
            joined["unnamed"] += part.steps["unnamed"][places]
            tables.append(joined)
        joined = _stacked(tables)
        if len(joined["confidence"]) > self._most_rows:
            raise TooManyError
        return joined

    def _is_new(self, steps: Table) -> Ids:
        """Return which steps were not known, or not so surely, (n,) bool."""
        subjects, relations, objects = (steps[column] for column in COLUMNS)
        is_new = (relations < self._relations) & ~self._is_literal[subjects]
        is_new &= steps["confidence"] > 0
        if self._only_named:
            is_new &= ~self._is_about_parts(steps)
        is_new &= (subjects != objects) | ~np.isin(relations, self._hierarchies)
        keys = self._keys(steps)
        for batch in self.batches:
            is_new &= steps["confidence"] > batch.confidence_of(keys) * 1.000001
        return is_new

    def _is_about_parts(self, steps: Table) -> Ids:
        """Return whether steps are about parts of axioms, which have no names, (n,) bool."""
        return self._is_part[steps["subject"]] | self._is_part[steps["object"]]

    def _keys(self, steps: Table) -> Ids:
        return mixed(map(steps.__getitem__, _ORDER), self._size)
