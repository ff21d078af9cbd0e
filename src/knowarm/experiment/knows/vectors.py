"""Knowledge as vectors: of all objects, of the target, of the query."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, get_args

from knowarm.experiment.answers import asked
from knowarm.experiment.knows.member import Known, Member
from knowarm.knowledge import KnowledgeGraph
from knowarm.knowledge.config import Detail, KnowledgeConfig, Scope
from knowarm.knowledge.formats import read_graph
from knowarm.knowledge.vectors.placebos import Zeros
from knowarm.policy.config import PolicyConfig
from knowarm.world.config import EnvConfig, facets_of


@dataclass(frozen=True, kw_only=True)
class FromGraph(Member, KnowledgeConfig):
    """Base of the members with vectors that a graph gives their meaning."""

    kind: str = ""

    def policy(self, config: PolicyConfig) -> PolicyConfig:
        """As `Member.policy`: it trains vectors whose source gives them no meaning."""
        encoder = self.source.encoder
        return config if encoder == "identity" else replace(config, knowledge_encoder=encoder)

    def input_sizes(self, embedded: Known) -> tuple[int, int]:
        """As `Member.input_sizes`: those of a row."""
        assert embedded.embedding is not None
        return embedded.embedding.dim, embedded.embedding.slots_per_row

    @property
    def rank(self) -> int:
        """As `Member.rank`."""
        return 1 + get_args(Detail).index(self.detail)

    @property
    def has_content(self) -> bool:
        """As `Member.has_content`."""
        return not isinstance(self.source, Zeros)

    def read_graph(self) -> KnowledgeGraph:
        """As `Member.read_graph`."""
        return read_graph(self.graph)

    def is_of_graph(self, graph: str) -> bool:
        """As `Member.is_of_graph`."""
        return self.graph == graph


@dataclass(frozen=True, kw_only=True)
class AboutFacets(FromGraph):
    """Base of the members with vectors that describe facets, objects with colours."""

    def embed(self, env: EnvConfig, run_seed: int, **how: Any) -> Known:
        """As `Member.embed`."""
        from knowarm.knowledge import scene_embedding

        facets, graph = facets_of(env), how.get("graph")
        embedding = scene_embedding(self, facets, run_seed=run_seed, graph=graph)
        return Known(embedding, embedding.table(facets))


@dataclass(frozen=True, kw_only=True)
class SceneVector(AboutFacets):
    """Vector of all objects of the task, the same in every episode (the paper's)."""

    kind: Literal["scene"] = "scene"
    """Tag in JSON."""


@dataclass(frozen=True, kw_only=True)
class TargetVector(AboutFacets):
    """Vector of the episode's own object and colour, which no camera saw: privileged."""

    scope: ClassVar[Scope] = "target"
    kind: Literal["target"] = "target"
    """Tag in JSON."""


@dataclass(frozen=True, kw_only=True)
class AboutQueries(FromGraph):
    """Base of the members with vectors that describe queries, in tasks with queries.

    A row has one slot per condition, from the subgraph around its value, with ``hops`` 0 from its
    own words.
    """

    scope: ClassVar[Scope] = "query"

    def embed(
        self,
        env: EnvConfig,
        run_seed: int,
        *,
        graph: KnowledgeGraph | None = None,
        trained: EnvConfig | None = None,
    ) -> Known:
        """As `Member.embed`."""
        from knowarm.knowledge import query_embedding

        trained_on, queries = asked(trained or env).queries, asked(env).queries
        options: dict[str, Any] = {"run_seed": run_seed, "graph": graph, "trained_on": trained_on}
        embedding = query_embedding(self, queries, **options)
        return Known(embedding, embedding.table(queries))


@dataclass(frozen=True, kw_only=True)
class QueryVector(AboutQueries):
    """Vector of the query of the episode."""

    kind: Literal["query"] = "query"
    """Tag in JSON."""
