"""Roles and colours of agents until the registry has them."""

from knowarm.experiment.agents import AGENTS

ROLES = {
    "bm": "baseline",
    "target": "privileged",
    "target+": "privileged",
    "zeros": "capacity_control",
    "wide": "capacity_control",
    "target-onehot": "content_control",
    "random": "content_control",
    "shuffled": "content_control",
    "onehot": "content_control",
    "wrong-object": "content_control",
    "learned": "content_control",
}
COLOURS = {
    "full": "c-blue",
    "bm": "c-orange",
    "partial": "c-green",
    "full+": "c-navy",
    "target": "c-gold",
    "zeros": "c-grey",
    "random": "c-purple",
    "shuffled": "c-pink",
    "onehot": "c-teal",
    "wide": "c-brown",
}


def registered_role(name: str) -> str | None:
    """Return an agent's role."""
    if name not in AGENTS:
        return None
    return getattr(AGENTS[name], "role", ROLES.get(name, "knowledge"))


def registered_colour(name: str) -> str | None:
    """Return an agent's colour."""
    if name not in AGENTS:
        return None
    return getattr(AGENTS[name], "colour", COLOURS.get(name))
