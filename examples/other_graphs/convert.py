"""Graphs that others wrote, converted for the choose task.

RoboCSE (BSD-3-Clause): household facts of the simulators AI2-THOR and VirtualHome.

    git clone --depth 1 https://github.com/adaruna3/robocse
    python examples/other_graphs/convert.py robocse/datasets/THOR_U thor.tsv

BEHAVIOR-1K (MIT): properties and kinds of things in the package bddl.

    pip download --no-deps --no-binary :all: bddl==3.6.0 && tar xf bddl-3.6.0.tar.gz
    python examples/other_graphs/convert.py \\
      bddl-3.6.0/bddl/generated_data/synsets.csv behavior.tsv

Then ask, or train:

    knowarm knowledge queries --graph thor.tsv
    knowarm ask zoo/irb120-choose-subgraph-fast "ObjCanBe pour" --graph thor.tsv
"""

import argparse
import csv
import hashlib
import re
from collections.abc import Iterator
from pathlib import Path

from knowarm import UserError
from knowarm.world.objects import TARGETS

DIGESTS = {
    "THOR_U": "8b630ff01126693b47188bd6bafd402dddc799414bf6221cdc7ce46224c51bcf",
    "VH+_U": "210c318e098d748e18f6c987240ebdc44e84853996fde7a3c4c6c4d2b688c417",
    "synsets.csv": "db395c037ecf2d374fae06a664fdcc898cacc89fb3445dd954b2f03b418ad742",
}
"""SHA-256 of the files that this script was tried with, by name of file or folder."""

SYNSETS = (
    "mug.n.04", "bottle.n.03", "teapot.n.01", "kettle.n.01", "pitcher.n.02", "bowl.n.01",
    "vase.n.01", "pot.n.04", "can.n.01", "flashlight.n.01", "mallet.n.01", "bucket.n.01",
    "watering_can.n.01", "toolbox.n.01", "bell.n.01", "globe.n.03",
)  # fmt: skip
"""The task's objects in BEHAVIOR. Its "basket" is that of basketball."""

COLUMNS = {"synset", "hypernyms", "prune", "is_custom", "objectType", "sceneObject"}
"""Columns that are no property."""

Triple = tuple[str, str, str]


def robocse(folder: Path) -> Iterator[Triple]:
    """Yield all triples of an OpenKE folder of RoboCSE, with the names of the task's objects.

    A name ends with its kind: object, location, room, material, action or state (.o, .l, .r, .m,
    .a, .s). Objects lose this ending; so do others whose name is unique: kitchen, but mug (l).
    """
    wanted = {name.replace("_", ""): name for name in TARGETS}
    entities = dict(
        line.rsplit(None, 1)[::-1] for line in lines(folder / "entity2id.txt")
    )
    relations = dict(
        line.rsplit(None, 1)[::-1] for line in lines(folder / "relation2id.txt")
    )
    kinds: dict[str, set[str]] = {}
    for entity in entities.values():
        name, _, kind = entity.rpartition(".")
        kinds.setdefault(name, set()).add(kind)

    def name_of(number: str) -> str:
        name, _, kind = entities[number].rpartition(".")
        if kind == "o":
            return wanted.get(name, name)
        return f"{name} ({kind})" if len(kinds[name]) > 1 else name

    for part in ("train", "valid", "test"):
        for line in lines(folder / f"{part}2id.txt"):
            head, tail, relation = re.split(r"[,\s]+", line.strip())
            yield name_of(head), relations[relation], name_of(tail)


def lines(path: Path) -> list[str]:
    """Read the lines of a file after the first, which counts them."""
    return [line for line in path.read_text().splitlines()[1:] if line.strip()]


def behavior(path: Path) -> Iterator[Triple]:
    """Yield properties and kinds of the task's objects, and the kinds of these kinds."""
    with path.open(newline="") as file:
        rows = {row["synset"]: row for row in csv.DictReader(file)}
    waiting, seen = list(SYNSETS), set(SYNSETS)
    while waiting:
        synset = waiting.pop()
        row = rows.get(synset)
        if row is None:  # above the top of the file's tree
            continue
        name = synset.split(".")[0]
        if synset in SYNSETS:
            yield from (
                (name, "hasProperty", key)
                for key, value in row.items()
                if key not in COLUMNS and value == "1"
            )
        for kind in filter(None, row["hypernyms"].split(",")):
            yield (
                name,
                "isA",
                kind.split(".")[0] if kind.split(".")[0] != name else kind,
            )
            if kind not in seen:
                seen.add(kind)
                waiting.append(kind)


def digest(path: Path) -> str:
    """Return the SHA-256 of a file, or of the files of an OpenKE folder."""
    names = (
        "entity2id.txt",
        "relation2id.txt",
        "train2id.txt",
        "valid2id.txt",
        "test2id.txt",
    )
    files = [path / name for name in names] if path.is_dir() else [path]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def main() -> None:
    """Convert a folder of RoboCSE, or bddl's synsets.csv."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", type=Path)
    parser.add_argument("out", type=Path)
    arguments = parser.parse_args()
    source = arguments.source
    if source.name not in DIGESTS:
        raise SystemExit(f"{source} is none of {', '.join(DIGESTS)}.")
    try:
        found = digest(source)
        if found != DIGESTS[source.name]:
            print(f"{source} is not the version that this script was tried with.")
        triples = dict.fromkeys(
            robocse(source) if source.is_dir() else behavior(source)
        )
    except (OSError, ValueError, KeyError, UserError) as error:
        raise SystemExit(f"{source} cannot be read: {error}") from None
    with arguments.out.open("w", newline="") as file:
        csv.writer(file, delimiter="\t", lineterminator="\n").writerows(triples)
    print(f"Wrote {len(triples)} triples to {arguments.out}")


if __name__ == "__main__":
    main()
