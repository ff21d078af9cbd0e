"""Generator of a larger household graph of made-up apartments, written as an OpenKE folder.

Every object kind of the shipped graph gets several instances in apartments with people. What an
instance is made of, used for and grasped at follows from its kind; where it stands, who owns it and
what it stands next to are drawn at random, and inverse and symmetric relations repeat it: so a
held-out fact can often, but not always, be inferred.

    python -m benchmarks.apartment_graph --out runs/apartment
"""

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks.triple_splits import Split, split_graph
from knowarm.knowledge import KnowledgeGraph, graph_of, household

INHERITED = (
    "isMadeOf",
    "hasShape",
    "usedFor",
    "graspedAt",
    "approachedFrom",
    "hasSize",
)
PEOPLE = ("ana", "ben", "chen", "dora", "emil", "fay")


def apartment_graph(instances: int = 5, seed: int = 0) -> KnowledgeGraph:
    """Make the graph: household facts and `instances` of every object kind."""
    generator = np.random.default_rng(seed)
    base = list(household())
    by_kind: dict[str, list[tuple[str, str]]] = {}
    for head, relation, tail in base:
        by_kind.setdefault(head, []).append((relation, tail))
    kinds = sorted(
        k for k, facts in by_kind.items() if any(r == "hasColor" for r, _ in facts)
    )
    triples = list(base)
    for i, person in enumerate(PEOPLE):
        triples.append((person, "isA", "person"))
        triples.append((person, "livesIn", f"apartment_{i % 3}"))
        triples.append((f"apartment_{i % 3}", "isHomeOf", person))
    placed: dict[str, list[str]] = {}
    for kind in kinds:
        facts = by_kind[kind]
        colours = [tail for relation, tail in facts if relation == "hasColor"]
        rooms = [tail for relation, tail in facts if relation == "isLocatedIn"]
        for number in range(instances):
            thing, owner = f"{kind}_{number}", PEOPLE[generator.integers(len(PEOPLE))]
            home = PEOPLE.index(owner) % 3
            place = f"{rooms[generator.integers(len(rooms))]}_{home}"
            triples += [
                (thing, "isInstanceOf", kind),
                (thing, "hasColor", colours[generator.integers(len(colours))]),
                (thing, "isOwnedBy", owner),
                (owner, "owns", thing),
                (thing, "standsIn", place),
                (place, "holds", thing),
            ]
            triples += [
                (thing, relation, tail)
                for relation, tail in facts
                if relation in INHERITED
            ]
            placed.setdefault(place, []).append(thing)
    for place, things in sorted(placed.items()):
        room, apartment = place.rsplit("_", 1)
        triples.append((place, "isInstanceOf", room))
        triples.append((place, "isPartOf", f"apartment_{apartment}"))
        for left, right in pairwise(things):
            triples += [(left, "isNextTo", right), (right, "isNextTo", left)]
    return graph_of(triples)


def write_openke(split: Split, folder: Path) -> None:
    """Write the folder that `read_split` reads."""

    def write(name: str, lines: list[str]) -> None:
        (folder / f"{name}2id.txt").write_text(
            "\n".join([str(len(lines)), *lines]) + "\n"
        )

    folder.mkdir(parents=True, exist_ok=True)
    for kind, names in (
        ("entity", split.graph.names),
        ("relation", split.graph.relation_names),
    ):
        write(kind, [f"{name}\t{i}" for i, name in enumerate(names)])
    for part in ("train", "valid", "test"):
        write(part, [f"{h} {t} {r}" for h, r, t in getattr(split, part).tolist()])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--instances", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    graph = apartment_graph(arguments.instances, arguments.seed)
    split = split_graph(graph, seed=arguments.seed)
    write_openke(split, arguments.out)
    sizes = f"{len(split.train)} training, {len(split.valid)} validation, {len(split.test)} test"
    print(f"{graph} ({sizes}) -> {arguments.out}")


if __name__ == "__main__":
    main()
