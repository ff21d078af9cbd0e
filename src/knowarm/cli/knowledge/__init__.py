"""`knowarm knowledge ...`: from a graph to a vector, one step at a time."""

from knowarm.cli.knowledge.show import Show

COMMANDS: dict[str, type] = {
    "show": Show,
}
"""The commands of the group, by name."""
