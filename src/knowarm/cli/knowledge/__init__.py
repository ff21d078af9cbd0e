"""`knowarm knowledge`: commands that show each step from a graph to a vector."""

from typing import Any

from knowarm.cli.knowledge.fit import Fit
from knowarm.cli.knowledge.queries import Draw, Queries, Subgraph
from knowarm.cli.knowledge.scene import Embed, KnowledgeShow, ProbeCommand

COMMANDS: dict[str, Any] = {
    "show": KnowledgeShow,
    "subgraph": Subgraph,
    "embed": Embed,
    "fit": Fit,
    "probe": ProbeCommand,
    "draw": Draw,
    "queries": Queries,
}
"""The commands of the group, by name."""
