"""Knowledge configs and files shared by the tests of the knowledge."""

from pathlib import Path

from knowarm.experiment.agents import AGENTS
from knowarm.knowledge.kge.split import Split

KNOWLEDGE = {
    name: agent.knowledge for name, agent in AGENTS.items() if agent.knowledge.scope != "query"
}
"""Knowledge of every registered agent that describes scenes or targets, by the agent's name."""


def write_openke(split: Split, folder: Path) -> None:
    """Write the folder that `read_openke_split` reads."""

    def write(name: str, lines: list[str]) -> None:
        (folder / f"{name}2id.txt").write_text("\n".join([str(len(lines)), *lines]) + "\n")

    folder.mkdir(parents=True, exist_ok=True)
    for kind, names in (("entity", split.graph.names), ("relation", split.graph.relation_names)):
        write(kind, [f"{name}\t{i}" for i, name in enumerate(names)])
    for part in ("train", "valid", "test"):
        write(part, [f"{h} {t} {r}" for h, r, t in getattr(split, part).tolist()])
