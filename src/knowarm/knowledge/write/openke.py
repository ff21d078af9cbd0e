"""A split graph goes in; a folder of OpenKE's id files comes out."""

from pathlib import Path

import numpy as np

from knowarm.knowledge.kge.split import Split
from knowarm.knowledge.names import Names


def write_openke(split: Split, folder: Path) -> None:
    """Write entity2id.txt, relation2id.txt, and train2id.txt, valid2id.txt, test2id.txt.

    Each begins with the number of its lines; a triple's line is `head tail relation`, as OpenKE
    orders them. Names must hold no tab.
    """
    folder.mkdir(parents=True, exist_ok=True)
    _names(folder / "entity2id.txt", split.graph.names)
    _names(folder / "relation2id.txt", split.graph.relation_names)
    for name, triples in (("train", split.train), ("valid", split.valid), ("test", split.test)):
        _triples(folder / f"{name}2id.txt", triples)


def _names(path: Path, names: Names) -> None:
    lines = [str(len(names)), *(f"{name}\t{i}" for i, name in enumerate(names))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _triples(path: Path, triples: np.ndarray) -> None:
    lines = [str(len(triples)), *(f"{h} {t} {r}" for h, r, t in triples.tolist())]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
