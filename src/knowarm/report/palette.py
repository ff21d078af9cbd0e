"""Names of agents go in; the classes that colour them everywhere come out."""

from collections.abc import Iterable

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
    "untrained": "c-faint",
}
"""The paper's three agents keep the paper's colours: full blue, partial green, BM orange."""

SPARE = ("c-navy", "c-gold", "c-teal", "c-purple", "c-pink", "c-brown", "c-grey")
"""Given in order to agents the dict does not know."""


def colours(names: Iterable[str]) -> dict[str, str]:
    """One palette class a name; the same names always get the same classes."""
    chosen: dict[str, str] = {}
    for name in names:
        agent = name.split(" · ")[0]
        known = COLOURS.get(agent)
        taken = set(chosen.values())
        free = [spare for spare in SPARE if spare not in taken]
        if known and known not in taken:
            chosen[name] = known
        else:
            chosen[name] = free[0] if free else SPARE[len(chosen) % len(SPARE)]
    return chosen
