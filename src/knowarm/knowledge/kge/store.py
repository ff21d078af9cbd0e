"""Files of trained graph embeddings: safetensors with names and config, no pickled code."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from safetensors import safe_open
from safetensors.torch import save

from knowarm.config import from_dict
from knowarm.errors import UserError
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.kge import KgeConfig
from knowarm.knowledge.kge.models import KgeModel
from knowarm.knowledge.kge.train import new_model
from knowarm.reading import reading, writing

FORMAT = "knowarm-graph-embedding-1"
AGAIN = "Fit the model again with `knowarm knowledge fit GRAPH --out FILE`."
"""Remedy for a damaged file."""


class StoredModel(NamedTuple):
    """A trained model with the names of its rows."""

    config: KgeConfig
    model: KgeModel
    entities: tuple[str, ...]
    relations: tuple[str, ...]


def save_model(model: KgeModel, config: KgeConfig, graph: KnowledgeGraph, path: Path) -> None:
    """Write a model."""
    tensors = {name: value.detach().contiguous() for name, value in model.state_dict().items()}
    for name, names in (("entities", graph.names), ("relations", graph.relation_names)):
        tensors[f"names.{name}"] = torch.from_numpy(np.frombuffer(names.blob, np.uint8).copy())
    with writing(path, "Give another path."):
        path.parent.mkdir(parents=True, exist_ok=True)
        # `save_file` raises another type of error than `OSError` when a disk is full.
        path.write_bytes(save(tensors, {"format": FORMAT, "config": json.dumps(asdict(config))}))


def load_model(path: Path) -> StoredModel:
    """Read a model that `save_model` wrote."""
    if not path.is_file():
        raise UserError(f"There is no model file {path}. Write one with `save_model`.")
    with reading(path, AGAIN), safe_open(path, "pt") as file:
        about = file.metadata() or {}
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    if about.get("format") != FORMAT:
        raise UserError(
            f"{path} holds no graph embedding of KnowArm (format {about.get('format')!r}, expected "
            f"{FORMAT!r}). Make one with `knowarm knowledge fit GRAPH --out FILE`."
        )
    with reading(path, AGAIN):
        config = from_dict(KgeConfig, json.loads(about["config"]))
        entities, relations = (
            tuple(tensors.pop(f"names.{kind}").numpy().tobytes().decode().split("\0")[:-1])
            for kind in ("entities", "relations")
        )
        if not all(torch.isfinite(value).all() for value in tensors.values()):
            raise ValueError("it contains non-finite values")
        model = new_model(config, len(entities), len(relations))
        model.load_state_dict(tensors)
    return StoredModel(config=config, model=model, entities=entities, relations=relations)
