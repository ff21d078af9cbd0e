"""Answers to questions in words or SPARQL, with their evidence."""

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain

import numpy as np

from knowarm.asking.expressions import QuestionReader
from knowarm.asking.judgements import (
    Evidence,
    Individual,
    Judgement,
    Part,
    Place,
    surest,
    undescribed,
)
from knowarm.asking.lexicon import tokens
from knowarm.asking.plain_words import PlainReading, read_plain
from knowarm.asking.vocabulary import Vocabulary
from knowarm.errors import Argument, UserError, unknown_name
from knowarm.knowledge.graph.builder import graph_of
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.homonyms import short
from knowarm.knowledge.graph.individuals import Meant, classes_of, may_be, meant
from knowarm.knowledge.graph.names import AmbiguousNameError
from knowarm.knowledge.graph.terms import local_name, name_key, name_of_iri
from knowarm.knowledge.queries.sparql import Answer, SparqlQuery, limited
from knowarm.knowledge.queries.store import stating
from knowarm.questions import AND, COLOUR_RELATION, ObjectColour

_SPARQL = re.compile(r"\s*(PREFIX|BASE|SELECT|ASK|CONSTRUCT|DESCRIBE)\b", re.IGNORECASE)

_LOOKED_AT = 2_000
_TOLD = 4
"""Most entities that are no objects of a task: looked at and told of, where no object answers."""

Words = Mapping[str, Mapping[str, Sequence[str]]]
"""Objects by relation and value."""
Facets = Sequence[ObjectColour]
NamesInGraph = Mapping[str, str]
"""The graph's names for objects."""


_NO_ANSWER = Judgement(False, probability=0.0, is_stated=False)


@dataclass(frozen=True)
class Answers:
    """The answers to a question among F facets."""

    question: str
    facets: Facets
    judgements: Mapping[ObjectColour, Judgement]
    """The judgement on each facet that answers, or may answer."""
    part: Part
    """What the question says of an individual."""
    individuals: Mapping[ObjectColour, Sequence[Individual]]
    """What each facet may be in the graph."""
    has_places: bool = False
    """Whether the places in a scene decide: `within` says who answers there."""
    left_out: Sequence[str] = ()
    """Words that were left out when the question was read."""
    graph: KnowledgeGraph | None = field(default=None, compare=False, repr=False)
    """What answered."""

    @property
    def as_read(self) -> str:
        """The question as it was read, with what was left out."""
        if not self.left_out:
            return self.question
        words = ", ".join(map(repr, self.left_out))
        return f"{self.question} (left out: {words})"

    @property
    def evidence(self) -> dict[ObjectColour, Evidence]:
        """Why each facet answers."""
        return {
            facet: judgement.evidence for facet, judgement in self.judgements.items()
        }

    @property
    def satisfies(self) -> np.ndarray:
        """Whether each facet answers, (F,) bool."""
        return np.array([facet in self.judgements for facet in self.facets])

    @property
    def degrees(self) -> np.ndarray:
        """Probability that each facet answers, by the confidence of facts, (F,) float."""
        return np.array([judgement.probability for judgement in self._of_facets])

    @property
    def stated(self) -> np.ndarray:
        """As `degrees`, of those alone whose answer does not rest on what is not stated, (F,)."""
        is_stated = [judgement.is_stated for judgement in self._of_facets]
        return np.where(is_stated, self.degrees, 0.0)

    @property
    def _of_facets(self) -> list[Judgement]:
        return [self.judgements.get(facet, _NO_ANSWER) for facet in self.facets]

    def within(self, scene: Mapping[ObjectColour, Place]) -> "Answers":
        """Return the answers among what stands at places of a scene, if places decide."""
        if not self.has_places:
            return self
        neighbours: list[Individual] = []  # what they are seen beside
        placed: dict[ObjectColour, list[Individual]] = {}
        for facet, place in scene.items():
            placed[facet] = []
            for individual in self.individuals[facet]:
                placed[facet].append(replace(individual, place=place, scene=neighbours))
            neighbours += placed[facet]
        return replace(self, judgements=_answering(self.part, placed))


def _judged(
    part: Part, individuals: Mapping[ObjectColour, Sequence[Individual]]
) -> dict[ObjectColour, Judgement]:
    """Return the judgement on each facet, by what it may be in the graph."""
    return {facet: surest(map(part, individuals[facet])) for facet in individuals}


def _answering(
    part: Part, individuals: Mapping[ObjectColour, Sequence[Individual]]
) -> dict[ObjectColour, Judgement]:
    """Return the judgements on the facets that answer, or may answer."""
    judged = _judged(part, individuals)
    return {facet: judged[facet] for facet in judged if judged[facet].answers}


def answer(
    graph: KnowledgeGraph,
    facets: Facets,
    text: str,
    names: NamesInGraph | None = None,
) -> Answers:
    """Answer a question by a graph; objects that it does not describe never answer.

    Args:
        graph: the graph.
        facets: objects with their colours.
        text: the question.
        names: the graph's names for objects, where they differ by more than their spelling.

    Raises:
        UserError: the question is malformed, names what the graph does not hold, or has no answer.

    Warns:
        DataWarning: the graph has several entities with the name of an object.
    """
    answering = _Answering(graph, facets, names)
    read = answering.read(text)
    answers = replace(answering.answers(read.text), left_out=read.left_out, graph=graph)
    if not answers.judgements:
        raise answering.no_answer(answers)
    return answers


def reading(
    graph: KnowledgeGraph,
    facets: Facets,
    text: str,
    names: NamesInGraph | None = None,
) -> str:
    """Return a question as `answer` reads it: plain English becomes conditions of the graph."""
    return _Answering(graph, facets, names).read(text).text


def row_of(prompt: str, rows: Sequence[str]) -> str:
    """Return the query among rows, "usedFor drinking and hasColor blue", that a prompt means.

    Raises:
        UserError: the prompt is not understood, or means none of them.
    """
    if prompt in rows:
        return prompt
    by_conditions = {frozenset(row.split(AND)): row for row in rows}
    triples = []
    colours = []
    for condition in frozenset[str]().union(*by_conditions):
        relation, _, value = condition.partition(" ")
        if value:
            triples.append(("it", relation, value))
        if value and relation == COLOUR_RELATION:
            colours.append(value)
    graph = graph_of(triples)
    vocabulary = Vocabulary(graph, graph.heads[:1], sorted(colours))
    text = read_plain(prompt, vocabulary, lambda _: set()).text
    row = by_conditions.get(frozenset(text.replace('"', "").split(AND)))
    if row is None:
        raise UserError(
            f"The policy knows no query {text!r}, as which {prompt!r} is read."
        )
    return row


class _Answering:
    """Answers questions about facets by a graph.

    Attributes:
        colours: the colours of the facets.
        objects: their names.
        meant: what those that the graph describes stand for.
    """

    def __init__(
        self, graph: KnowledgeGraph, facets: Facets, names: NamesInGraph | None
    ) -> None:
        self.graph = graph
        self.facets = facets
        self.colours = dict.fromkeys(colour for _, colour in facets)
        self.objects = dict.fromkeys(name for name, _ in facets)
        self._parts: dict[str, tuple[Part, bool]] = {}
        self.meant = self._meant(names or {})
        if not self.meant:
            raise self._none_described()

    def _meant(self, names: NamesInGraph) -> dict[str, Meant]:
        for name in names:
            if name not in self.objects:
                raise unknown_name("object of the task", name, self.objects)
        described = meant(self.graph, self.objects, names)
        for name in names.keys() - described.keys():
            self.graph.entity_id(names[name])  # which raises the error
        return described

    def _none_described(self) -> UserError:
        example = "mug=MyMug"
        for name in self.objects:
            near = self.graph.entity_spellings.near(name)
            if near:
                example = f"{name}={near[0]}"
                break
        return UserError(
            f"The graph describes none of the {len(self.objects)} objects of the task, such "
            f"as {next(iter(self.objects))!r}. Give its names for them, such as ",
            Argument("names", example),
            ", or give another graph.",
        )

    def read(self, text: str) -> PlainReading:
        """Return a question as it is if it is one in conditions, or plain English as conditions."""
        if _SPARQL.match(text):
            return PlainReading(text)
        reader = QuestionReader(text, self.graph, self.colours, self.objects)
        try:
            self._parts[text] = reader.whole(), reader.has_places
            return PlainReading(text)
        except AmbiguousNameError:
            raise
        except UserError as error:
            # Its traceback would keep this frame, and what callers hold.
            exact = error.with_traceback(None)
        try:
            plain = read_plain(text, self.vocabulary, self.holders)
        except UserError as error:
            raise exact if reader.has_relation else error from None
        if reader.has_relation and not self.holders(plain.text):
            raise exact  # it names the values that there are
        return plain

    @cached_property
    def vocabulary(self) -> Vocabulary:
        """What can be asked in plain English."""
        known = self.known(self.meant)
        return Vocabulary(self.graph, known, self.colours, self.objects)

    def known(self, names: Iterable[str]) -> list[int]:
        """Return the entities whose facts are known of objects: their individuals and classes."""
        known: dict[int, None] = {}
        for name in names:
            entity, individuals = self.meant[name]
            for one in (*individuals, entity):
                if one is not None:
                    known.update(dict.fromkeys([one, *classes_of(self.graph, one)]))
        return list(known)

    @cached_property
    def individuals(self) -> dict[ObjectColour, list[Individual]]:
        """What each facet may be in the graph; none of its entities if it has none."""
        individuals = {}
        for name, colour in self.facets:
            described = self.meant.get(name, Meant(None, ()))
            individuals[name, colour] = [
                Individual(entity, name, colour)
                for entity in may_be(self.graph, described, colour)
            ]
        return individuals

    def answers(self, text: str) -> Answers:
        """Answer a question in SPARQL or conditions."""
        part, has_places = self.part(text)
        judgements = _answering(part, self.individuals)
        return Answers(
            text, self.facets, judgements, part, self.individuals, has_places
        )

    def part(self, text: str) -> tuple[Part, bool]:
        """Return what a question says of an individual, and whether places decide; read once."""
        if text not in self._parts:
            if _SPARQL.match(text):
                ones = list(chain.from_iterable(self.individuals.values()))
                judgements = limited(_sparql, self.graph, text, ones)
                judged = dict(zip(ones, judgements, strict=True))
                self._parts[text] = judged.__getitem__, False
            else:
                reader = QuestionReader(text, self.graph, self.colours, self.objects)
                self._parts[text] = reader.whole(), reader.has_places
        return self._parts[text]

    def holders(self, text: str) -> set[int]:
        """Return the entities of the objects that answer a question."""
        names = {name for name, _ in self.answers(text).judgements}
        return set(self.known(names & self.meant.keys()))

    def no_answer(self, answers: Answers) -> UserError:
        """Return the error of a question that no object answers: what denies it, what is near."""
        denied: dict[str, None] = {}
        for (name, _), judgement in _judged(answers.part, self.individuals).items():
            if judgement.is_stated and name in self.meant:
                denied.update(dict.fromkeys(judgement.evidence))
        text = f"No object of the task answers the question {answers.question!r}."
        if denied:
            text += f" What speaks against it: {'; '.join(list(denied)[:4])}."
        is_sparql = _SPARQL.match(answers.question) is not None
        # A query in SPARQL takes milliseconds per entity
        others = [] if is_sparql else self.others(answers.part)
        if others:
            text += f" In the graph it is true of {', '.join(others)}: no object stands for that."
        if is_sparql:
            hint = SparqlQuery(self.graph, answers.question).hint
        else:
            words = tokens(answers.question)
            hint = self.vocabulary.nearest(words, answers.question)
        if hint:
            text += f" {hint}"
        return UserError(
            f"{text} Ask another one, or add the missing triple to the graph."
        )

    def others(self, part: Part) -> list[str]:
        """Return entities that no object stands for, and of which the graph states a question."""
        others = []
        of_objects = self.known(self.meant)
        entities = np.unique(self.graph.heads)[:_LOOKED_AT]
        for entity in entities[~np.isin(entities, of_objects)].tolist():
            judgement = part(Individual(entity))
            is_stated = judgement.is_stated and not judgement.is_open
            if judgement.answers and is_stated:
                others.append(self.graph.names[entity])
        return others[:_TOLD]


def words(
    graph: KnowledgeGraph, facets: Facets, names: NamesInGraph | None = None
) -> Words:
    """Return what a graph can be asked about objects: colours first, then its facts.

    Facts that are less probable than not are none of them.

    Args:
        graph, facets, names: as of `answer`.
    """
    objects = defaultdict[str, dict[str, list[str]]](dict)
    for name, colour in facets:
        objects[COLOUR_RELATION].setdefault(colour, []).append(name)
    answering = _Answering(graph, facets, names)
    for name in answering.meant:
        rows = np.concatenate(list(map(graph.out_rows, answering.known([name]))))
        for row in graph.believed(rows):
            tail = graph.tails[row]
            relation = graph.relation_names.short(graph.relations[row])
            is_unnamed = graph.names[tail].startswith(('"', "_:"))
            if is_unnamed or local_name(relation) == COLOUR_RELATION:
                continue
            value = short(graph, tail)
            names_of_value = objects[relation].setdefault(value, [])
            if name not in names_of_value:
                names_of_value.append(name)
    return objects


def _sparql(
    graph: KnowledgeGraph, text: str, individuals: Iterable[Individual]
) -> list[Judgement]:
    """Judge individuals by what a SPARQL query selects as ?object, if it does in a ?colour.

    It runs once per facet, whose colour the graph then states, as the image shows it; once for all
    if it reads no colours.
    """
    query = SparqlQuery(graph, text)
    ids = graph.relation_names.find_local(COLOUR_RELATION)
    # The query may write :hasColor and :blue without a fact of these.
    own = query.prefixes[""]
    relations = {
        COLOUR_RELATION,
        name_of_iri(own + COLOUR_RELATION),
        *map(graph.relation_names.__getitem__, ids),
    }

    is_coloured = query.may_read(COLOUR_RELATION)
    by_object = defaultdict[str, list[dict[str, str]]](list)
    if not is_coloured:
        for row in _rows(query.run()):
            by_object[row["object"]].append(row)

    def rows(name: str, colour: str | None) -> list[dict[str, str]]:
        """Return the rows that select an entity, as if it had a colour alone."""
        if not is_coloured:
            return by_object[name]
        shown = []
        if colour is not None:
            plain = [colour, name_of_iri(own + colour)]
            shown = graph.names.at(graph.alike(colour)) or plain
        with stating(query.store, name, relations, shown):
            return [row for row in _rows(query.run(name)) if row["object"] == name]

    def judge(individual: Individual) -> Judgement:
        if individual.entity is None:
            return undescribed(individual)
        judgements = []
        for entity in (individual.entity, *classes_of(graph, individual.entity)):
            selecting = rows(graph.names[entity], individual.colour)
            judgements.append(_selected(selecting, individual.colour))
        return surest(judgements)

    return list(map(judge, individuals))


def _rows(result: Answer) -> list[dict[str, str]]:
    """Return the rows of a query, by variable.

    Raises:
        UserError: it selects other things than ?object and ?colour.
    """
    other = set(result.columns) - {"object", "colour", "color"}
    if "object" not in result.columns or other:
        raise UserError(
            "A question in SPARQL must select ?object, and may select ?colour, and no more; "
            f"got {', '.join(result.columns) or 'no variables'}. Example: SELECT ?object "
            "WHERE { ?object :usedFor :drinking }"
        )
    return [dict(zip(result.columns, row, strict=True)) for row in result.rows]


def _selected(rows: Iterable[Mapping[str, str]], colour: str | None) -> Judgement:
    """Return the judgement on an object in a colour by the rows in which a query selects it.

    All colours that a row selects must be the one that is shown.
    """
    for row in rows:
        values = {key: local_name(value) for key, value in row.items()}
        colours = {name_key(values[key]) for key in values if key != "object"}
        if colours - {""} <= {name_key(colour or "")}:
            reasons = [f"?{key} = {value}" for key, value in values.items()]
            return Judgement(True, tuple(reasons))
    return Judgement(False, is_stated=False)
