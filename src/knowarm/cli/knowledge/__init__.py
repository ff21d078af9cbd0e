"""`knowarm knowledge`: commands that show each step from a graph to a vector."""

from collections.abc import Sequence
from typing import Any

import tyro

from knowarm.cli.knowledge.embed import Embed
from knowarm.cli.knowledge.fit import Evaluate, Fit
from knowarm.cli.knowledge.options import SceneOptions, take_source
from knowarm.cli.knowledge.probe import ProbeCommand
from knowarm.cli.knowledge.queries import Queries
from knowarm.cli.knowledge.show import Show
from knowarm.cli.knowledge.subgraph import Draw, Subgraph
from knowarm.errors import unknown_name
from knowarm.knowledge import KnowledgeConfig

COMMANDS: dict[str, Any] = {
    "show": Show,
    "subgraph": Subgraph,
    "embed": Embed,
    "fit": Fit,
    "evaluate": Evaluate,
    "probe": ProbeCommand,
    "draw": Draw,
    "queries": Queries,
}
"""The commands of the group, by name."""


def parse(arguments: Sequence[str]) -> Any:
    """Parse the words after `knowarm knowledge`; `--source` takes a short name.

    Raises:
        UserError: there is no such command or source.
    """
    name, *rest = arguments or [""]
    if name not in COMMANDS:
        if name and not name.startswith("-"):
            raise unknown_name("knowledge command", name, COMMANDS)
        return tyro.extras.subcommand_cli_from_dict(
            COMMANDS, prog="knowarm knowledge", description=__doc__, args=arguments
        )
    command, default = COMMANDS[name], None
    if issubclass(command, SceneOptions):
        rest, source = take_source(rest, "--source")
        if source is not None:
            default = command(knowledge=KnowledgeConfig(detail="full", source=source))
    return tyro.cli(command, prog=f"knowarm knowledge {name}", args=rest, default=default)
