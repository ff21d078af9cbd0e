"""Rules over triples: joins of integer arrays that remember what each new triple follows from."""

import copy
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from knowarm.knowledge.graph.graph import Ids

MOST = 5_000_000
"""Most triples that may follow, and most rows of a join."""
MOST_ROUNDS = 300
"""Most rounds: the longest way along one relation."""
PREMISES = 4
"""Most triples from which one follows in one step."""
_Atom = tuple[str, str, str]
"""Subject, relation and object: a variable ("?x") or the word of a constant."""


class TooManyError(Exception):
    """More follows than `MOST`."""


class Rule(NamedTuple):
    """What follows if all atoms of a body hold."""

    body: tuple[_Atom, ...]
    head: _Atom
    step: _Atom | None
    """The atom of the body that holds of single steps alone, so that each way is gone once."""


def read_rules(text: str) -> list[Rule]:
    """Read one rule per line: ``?x type ?c, ?c subClassOf ?d -> ?x type ?d``.

    An atom in brackets, ``[?c subClassOf ?d]``, holds of single steps: of what does not follow by a
    rule with brackets.
    """
    rules = list[Rule]()
    for line in filter(None, map(str.strip, text.splitlines())):
        left, _, right = line.partition(" -> ")
        step = None
        body = list[_Atom]()
        for text_of_atom in left.split(", "):
            atom = _atom(text_of_atom.strip("[]"))
            body.append(atom)
            if text_of_atom.startswith("["):
                step = atom
        rules.append(Rule(tuple(body), _atom(right), step))
    return rules


def _atom(text: str) -> _Atom:
    subject, relation, value = text.split()
    return subject, relation, value


_BY_TRIPLE = ("keys", "confidence", "premises", "unnamed", "is_step", "numbers")


class Round:
    """Distinct triples that follow in one round, sorted by relation, subject and object.

    Attributes:
        columns: ids of subjects, relations and objects, each (n,) int32.
        keys: one number per triple, (n,) int64, sorted.
        confidence: probability that each holds, (n,) float32.
        premises: numbers of the triples that each follows from, (n, 4) int32; -1 is none.
        unnamed: 1 of triples about parts of axioms, which have no names, else 0; (n,) int8.
        numbers: numbers of the triples, (n,).
        is_step: whether each is a single step, (n,) bool.
    """

    def __init__(self, news: "News", is_part: Ids, first: int) -> None:
        """Sort triples; of equal ones the surest stays, with the fewest unnamed premises.

        Args:
            news: the triples.
            is_part: whether each id is a part of an axiom, (size,) bool.
            first: number of the first triple.
        """
        size = len(is_part)
        triples, confidence, premises, unnamed, is_step = news
        keys = mixed([triples[:, 1], triples[:, 0], triples[:, 2]], size)
        order = np.lexsort((unnamed, -confidence, keys))
        keys = keys[order]
        is_new = np.ones(len(keys), bool)
        is_new[1:] = keys[1:] != keys[:-1]
        order = order[is_new]
        self.keys = keys[is_new]
        self.columns = np.ascontiguousarray(triples[order].T.astype(np.int32))
        self.confidence = confidence[order].astype(np.float32)
        self.premises = premises[order].astype(np.int32)
        self.is_step = is_step[order]
        ends = is_part[self.columns]
        self.unnamed = (ends[0] | ends[2]).astype(np.int8)
        self.numbers = first + np.arange(len(order))
        self._size = size
        self._indices: dict[tuple[int, ...], tuple[Ids, Ids]] = {}
        self._parts: dict[tuple[int, ...], Round] = {}

    def __len__(self) -> int:
        return len(self.keys)

    def of(self, relations: tuple[int, ...]) -> "Round":
        """Return the triples of some relations."""
        if relations not in self._parts:
            self._parts[relations] = self.part(np.isin(self.columns[1], relations))
        return self._parts[relations]

    def steps(self) -> "Round":
        """Return the triples that are single steps."""
        if _STEPS not in self._parts:
            self._parts[_STEPS] = self.part(self.is_step)
        return self._parts[_STEPS]

    def part(self, rows: Ids) -> "Round":
        """Return the triples of some rows, (k,) int or (n,) bool."""
        part = copy.copy(self)
        part.columns = self.columns[:, rows]
        for name in _BY_TRIPLE:
            setattr(part, name, getattr(self, name)[rows])
        part._indices = {}
        part._parts = {}
        return part

    def with_(self, other: "Round") -> "Round":
        """Return the triples of both."""
        both = copy.copy(self)
        confidence = np.concatenate([self.confidence, other.confidence])
        order = np.lexsort((-confidence, np.concatenate([self.keys, other.keys])))
        columns = np.concatenate([self.columns, other.columns], axis=1)
        both.columns = np.ascontiguousarray(columns[:, order])
        for name in _BY_TRIPLE:
            values = np.concatenate([getattr(self, name), getattr(other, name)])
            setattr(both, name, values[order])
        both._indices = {}
        both._parts = {}
        return both

    def match(self, bound: Mapping[int, Ids], most: int) -> tuple[Ids, Ids]:
        """Return the pairs (number of the row, number of the triple) that agree.

        Args:
            bound: what stands in some of the columns, by column, each (n,) int.
            most: most pairs.

        Raises:
            TooManyError: there are more.
        """
        positions = tuple(sorted(bound, key=(1, 0, 2).index))
        if positions not in self._indices:
            columns = map(self.columns.__getitem__, positions)
            keys = mixed(columns, self._size, len(self))
            order = np.argsort(keys, kind="stable")
            self._indices[positions] = keys[order], order
        keys, order = self._indices[positions]
        wanted = mixed(map(bound.__getitem__, positions), self._size)
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
        places = np.searchsorted(self.keys, keys).clip(max=len(self) - 1)
        is_here = self.keys[places] == keys
        return np.where(is_here, self.confidence[places], np.float32(-1))


_Table = dict[str, Ids]
"""Rows of ids by variable, with the premises, confidence and number of unnamed premises of each."""
_START: _Table = {
    "confidence": np.ones(1, np.float32),
    "unnamed": np.zeros(1, np.int8),
}


class Reasoner:
    """Triples of ids, and all that follows by rules, round by round.

    Attributes:
        rounds: what was stated, what was added, and what followed in each round.
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
        self.rounds = list[Round]()
        self._size = len(is_literal)
        self._relations = relations
        self._is_literal = is_literal
        self._is_part = is_part
        self._constants = constants
        self._only_named = False
        self._most_rows = MOST
        self._allowed: dict[Rule, dict[str, tuple[int, ...]]] = {}

    def add(self, news: "News") -> Round:
        """Add triples that were not there."""
        batch = Round(news, self._is_part, self.count)
        self.rounds.append(batch)
        self._allowed.clear()
        # Few large rounds are searched faster than many small ones.
        while len(self.rounds) > 2 and len(self.rounds[-2]) < 2 * len(self.rounds[-1]):
            last = self.rounds.pop()
            self.rounds[-1] = self.rounds[-1].with_(last)
        return batch

    @property
    def count(self) -> int:
        """Number of all triples."""
        return sum(map(len, self.rounds))

    def everything(self) -> Round:
        """Return all triples in the order of their numbers."""
        whole = self.rounds[0]
        for later in self.rounds[1:]:
            whole = whole.with_(later)
        return whole.part(np.argsort(whole.numbers))

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
        before = list(self.rounds)
        self._only_named = only_named
        self._most_rows = min(MOST, 10 * most)
        self._allowed.clear()
        try:
            self._run(rules, self.count + most)
        except TooManyError:
            self.rounds = before
            raise

    def _run(self, rules: Sequence[Rule], most: int) -> None:
        new = list(self.rounds)
        is_first = True
        for _ in range(MOST_ROUNDS):
            results = list[News]()
            for rule in rules:
                if (
                    is_first
                ):  # all is new, so that one order of the atoms finds everything
                    results.append(self._apply(rule, 0, new))
                    continue
                for start in range(len(rule.body)):
                    results.append(self._apply(rule, start, new))
            is_first = False
            columns = map(np.concatenate, zip(*results, strict=True))
            news = News(*columns)
            new = []
            if len(news.triples):
                new = [self.add(news)]
            if not new:
                return
            if self.count > most:
                break
        raise TooManyError

    def _apply(self, rule: Rule, start: int, new: Sequence[Round]) -> "News":
        """Return what follows by a rule if one atom of its body is among the new triples."""
        table = self._join(_START, rule, rule.body[start], new)
        rest = [*rule.body[:start], *rule.body[start + 1 :]]
        while rest and len(table["confidence"]):

            def known(atom: _Atom, table: _Table = table) -> int:
                return len(table.keys() & set(atom))

            atom = max(rest, key=known)
            rest.remove(atom)
            table = self._join(table, rule, atom, self.rounds)
        count = len(table["confidence"])
        if not count:
            return _NOTHING
        columns = self._bound(table, rule.head)
        triples = np.stack([columns[0], columns[1], columns[2]], axis=1)
        news = stated(triples, table["confidence"])
        for number in range(len(rule.body)):
            news.premises[:, number] = table[f"premise {number}"]
        news.unnamed[:] = table["unnamed"]
        news.is_step[:] = rule.step is None
        return self._unknown(news)

    def _bound(self, table: _Table, atom: _Atom) -> dict[int, Ids]:
        """Return what is known of the columns of an atom, each (n,) int."""
        columns = dict[int, Ids]()
        for position, term in enumerate(atom):
            if term in table:
                columns[position] = table[term]
            elif not term.startswith("?"):
                count = len(table["confidence"])
                columns[position] = np.full(count, self._constants[term])
        return columns

    def _relations_of(self, rule: Rule) -> dict[str, tuple[int, ...]]:
        """Return the relations that axioms allow, by variable, as far as they restrict it."""
        if rule in self._allowed:
            return self._allowed[rule]
        allowed = dict[str, tuple[int, ...]]()
        variables = set(map(itemgetter(1), rule.body))
        for atom in rule.body:
            relation = self._constants.get(atom[1])
            for position in (0, 2):
                is_variable = atom[position].startswith("?")
                if (
                    relation is None
                    or not is_variable
                    or atom[position] not in variables
                ):
                    continue
                ids = list[int]()
                for batch in self.rounds:
                    ids += batch.of((relation,)).columns[position].tolist()
                allowed[atom[position]] = tuple(sorted(set(ids)))
        self._allowed[rule] = allowed
        return allowed

    def _join(
        self, table: _Table, rule: Rule, atom: _Atom, rounds: Iterable[Round]
    ) -> _Table:
        """Return the rows of a table with all triples that agree with an atom of a rule."""
        bound = self._bound(table, atom)
        relations = self._relations_of(rule).get(atom[1])
        columns = defaultdict[str, list[Ids]](list)
        premise = f"premise {sum(name.startswith('premise') for name in table)}"
        for batch in rounds:
            if atom == rule.step:
                batch = batch.steps()
            if relations is not None:
                batch = batch.of(relations)
            rows, matches = batch.match(bound, self._most_rows)
            for name, column in table.items():
                columns[name].append(column[rows])
            for position, term in enumerate(atom):
                if term.startswith("?") and term not in table:
                    columns[term].append(batch.columns[position][matches])
            columns[premise].append(batch.numbers[matches])
            columns["confidence"][-1] *= batch.confidence[matches]
            columns["unnamed"][-1] += batch.unnamed[matches]
        if sum(map(len, columns[premise])) > self._most_rows:
            raise TooManyError
        return {name: np.concatenate(parts) for name, parts in columns.items()}

    def _unknown(self, news: "News") -> "News":
        """Return the triples that were not known, or not so surely."""
        subjects, relations, objects = news.triples.T
        is_new = (relations < self._relations) & ~self._is_literal[subjects]
        is_new &= news.confidence > 0
        if self._only_named:
            is_new &= ~(self._is_part[subjects] | self._is_part[objects])
        hierarchies = list(map(self._constants.__getitem__, _HIERARCHIES))
        is_new &= (subjects != objects) | ~np.isin(relations, hierarchies)
        keys = mixed([relations, subjects, objects], self._size)
        for batch in self.rounds:
            is_new &= news.confidence > batch.confidence_of(keys) * 1.000001
        return News(*map(itemgetter(is_new), news))


class News(NamedTuple):
    """Triples to be added.

    ``triples`` (n, 3) of ids; ``confidence`` (n,); ``premises``, numbers of the triples that each
    follows from, (n, 4), -1 is none; ``unnamed``, how many premises are parts of axioms, (n,);
    ``is_step``, whether each is a single step, (n,).
    """

    triples: Ids
    confidence: Ids
    premises: Ids
    unnamed: Ids
    is_step: Ids


def stated(triples: Ids, confidence: Ids | None = None) -> News:
    """Return triples (n, 3) as news that follow from nothing, certain or of a confidence (n,)."""
    count = len(triples)
    if confidence is None:
        confidence = np.ones(count, np.float32)
    premises = np.full((count, PREMISES), -1)
    unnamed = np.zeros(count, np.int8)
    return News(triples, confidence, premises, unnamed, np.ones(count, bool))


_STEPS = (-1,)
"""Key of the single steps among parts of a batch."""
_HIERARCHIES = ("subClassOf", "subPropertyOf", "sameAs")
"""Relations that everything has to itself, which says nothing."""
_NOTHING = stated(np.empty((0, 3), np.int64))


def mixed(columns: Iterable[Ids], size: int, count: int = 1) -> Ids:
    """Return one number for the ids below ``size`` of several columns, (n,) int64.

    Of no columns these are ``count`` zeros.
    """
    keys = np.zeros(count, np.int64)
    for column in columns:
        keys = keys * size + column
    return keys
