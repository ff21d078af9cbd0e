"""`knowarm knowledge ...`: from a graph to a vector, one step at a time."""

from knowarm.cli.knowledge.draw import Draw
from knowarm.cli.knowledge.embed import Embed
from knowarm.cli.knowledge.evaluate import Evaluate
from knowarm.cli.knowledge.fit import Fit
from knowarm.cli.knowledge.probe import ProbeCommand
from knowarm.cli.knowledge.show import Show
from knowarm.cli.knowledge.subgraph import Subgraph

COMMANDS: dict[str, type] = {
    "show": Show,
    "subgraph": Subgraph,
    "embed": Embed,
    "fit": Fit,
    "evaluate": Evaluate,
    "probe": ProbeCommand,
    "draw": Draw,
}
"""The commands of the group, by name."""
