"""Query embedding: what a policy is told about the query of its episode, one row per query.

A slot describes one condition: by its words, or by the subgraph around its value. A row holds the
slots of a query's conditions side by side.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.config import KnowledgeConfig
from knowarm.knowledge.embedding import Described, SceneEmbedding, slot_matrix
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.queries import Condition, Query
from knowarm.knowledge.scene import Facets, load_graph
from knowarm.knowledge.sentence import Part, sentence_parts
from knowarm.knowledge.subgraph import gamma
from knowarm.knowledge.terms import label_of, local_name
from knowarm.knowledge.vectors.placebos import WrongObject


@dataclass(frozen=True, kw_only=True)
class QueryEmbedding(SceneEmbedding):
    """Slots of conditions, and the conditions of each query."""

    queries: dict[str, Query] = field(repr=False)
    """Every query by its text."""

    @property
    def width(self) -> int:
        """Slots per row: the largest number of conditions in a query."""
        return max(len(query.conditions) for query in self.queries.values())

    @property
    def dim(self) -> int:
        """K, the width of the policy's input: width * slot_dim."""
        return self.width * self.slot_dim if self.slots else 0

    @property
    def constant(self) -> bool:
        """Whether every query gets the same numbers."""
        return self.dim > 0 and bool(np.ptp(self.table(list(self.queries)), axis=0).max() == 0)

    def table(self, facets: Facets | Sequence[str]) -> np.ndarray:
        """Return the knowledge input of the policy for each query, (Q, K) float32.

        Facts fill the slots of a row from the first, colours from the last, so that a colour is
        found at one place in all queries; the rest is zero.

        Args:
            facets: the queries, by their texts.
        """
        if not self.slots:
            return np.zeros((len(facets), 0), np.float32)
        numbers = {slot: number for number, slot in enumerate(self.slots)}
        rows = np.zeros((len(facets), self.width, self.slot_dim), np.float32)
        for row, text in zip(rows, facets, strict=True):
            conditions = self.queries[str(text)].conditions
            facts = [c for c in conditions if not c.is_colour]
            colours = [c for c in conditions if c.is_colour]
            for place, condition in enumerate(facts):
                row[place] = self.matrix[numbers[condition]]
            for place, condition in enumerate(colours):
                row[self.width - len(colours) + place] = self.matrix[numbers[condition]]
        return rows.reshape(len(facets), -1)


def query_embedding(
    config: KnowledgeConfig,
    queries: Sequence[str],
    *,
    run_seed: int = 0,
    graph: KnowledgeGraph | None = None,
    trained_on: Sequence[str] = (),
) -> QueryEmbedding:
    """Embed what the graph knows about the queries of a task.

    Args:
        config: the graph, the source of vectors and the choices between; scope "query".
        queries: texts of the queries, such as "usedFor drinking and hasColor blue".
        run_seed: seed of the training run; only placebos that are drawn depend on it.
        graph: describe the queries by this graph in place of the config's, such as an edited one.
        trained_on: queries of the training, if these are others: a code that depends on the
            number of a condition then stays what it was.

    Raises:
        UserError: another scope, or a label or condition that cannot be found.

    Example:
        >>> config = KnowledgeConfig(detail="full", scope="query", graph="objects", hops=0)
        >>> query_embedding(config, ["usedFor drinking", "contains tea"]).matrix.shape
        (2, 50)
    """
    if config.scope != "query" and config.detail != "none":
        raise UserError(
            f"This task asks queries, which knowledge of scope {config.scope!r} does not describe. "
            "Set scope to 'query', or detail to 'none' for a policy that is told nothing."
        )
    if isinstance(config.source, WrongObject):
        raise UserError(
            "The placebo 'wrong-object' describes other objects, and a query has none. Take "
            "another placebo, such as 'shuffled'."
        )
    plain = load_graph(config, run_seed, graph)
    relations = [local_name(name) for name in plain.relation_names]
    parsed = {text: Query.parse(text, relations) for text in (*trained_on, *queries)}
    conditions = tuple(dict.fromkeys(c for query in parsed.values() for c in query.conditions))
    slots = conditions if config.detail != "none" else ()
    if slots and config.hops and not any(_entity(plain, c, config) for c in slots):
        raise UserError(
            f"The graph describes none of the {len(slots)} conditions of the queries, such as "
            f"{slots[0].name!r}. Set graph to the one that the queries were made from."
        )

    def describe(config: KnowledgeConfig, run_seed: int) -> Described:
        changed = load_graph(config, run_seed, graph)
        sentences = [condition_parts(changed, each, config) for each in slots]
        own = [_entity(changed, each, config) or each.value for each in slots]
        values = [Part(name, label_of(name, changed.labels), False) for name in own]
        alone = [
            {part.name for part in parts} == {name}
            for parts, name in zip(sentences, own, strict=True)
        ]
        shares = [None if only else name for only, name in zip(alone, own, strict=True)]
        return Described(changed, sentences, shares, values)

    matrix, sentences, coverage = slot_matrix(config, len(slots), describe, run_seed)
    return QueryEmbedding(
        config=config,
        slots=slots,
        matrix=matrix,
        coverage=coverage,
        sentences=sentences,
        note=config.source.note if slots else "",
        queries=parsed,
    )


def condition_parts(
    graph: KnowledgeGraph, condition: Condition, config: KnowledgeConfig
) -> list[Part]:
    """Return the labels that describe a condition: its own, then those of Gamma of its value.

    A value that the graph does not hold, such as a colour without facts, has its own label only.
    """
    held = _entity(graph, condition, config)
    value = held or condition.value
    parts = [Part(value, label_of(value, graph.labels), False)]
    if config.relation_words:
        names = (each for each in graph.relation_names if local_name(each) == condition.relation)
        relation = next(names, condition.relation)
        words = config.templates.get(relation)
        label = label_of(relation, graph.labels) if words is None else words.lower()
        parts = [Part(relation, label, True), *parts] if label else parts
    if config.hops == 0 or held is None:
        return parts
    around = gamma(
        graph,
        [held],
        hops=config.hops,
        direction=config.direction,
        relations=config.relations,
        max_degree=config.max_degree,
    )
    return [*parts, *(sentence_parts(around, config.sentence) if len(around) else [])]


def _entity(graph: KnowledgeGraph, condition: Condition, config: KnowledgeConfig) -> str | None:
    """Return the graph's name of a condition's value, or None if the graph does not hold it."""
    try:
        found = graph.entity_id(config.entity_names.get(condition.value, condition.value))
    except UserError:
        return None
    return graph.names[found]
