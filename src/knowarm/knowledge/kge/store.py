"""Files of trained graph embeddings: safetensors with names and config, no pickled code."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from knowarm.config import from_dict
from knowarm.errors import UserError
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.kge import KgeConfig
from knowarm.knowledge.kge.models import KgeModel
from knowarm.knowledge.kge.train import new_model
from knowarm.knowledge.names import SEPARATOR

FORMAT = "knowarm-graph-embedding-1"


@dataclass(frozen=True, kw_only=True)
class StoredModel:
    """A trained model with the names of its rows."""

    config: KgeConfig
    model: KgeModel = field(repr=False)
    entities: tuple[str, ...] = field(repr=False)
    relations: tuple[str, ...] = field(repr=False)


def save_model(model: KgeModel, config: KgeConfig, graph: KnowledgeGraph, path: Path) -> None:
    """Write a model.

    Raises:
        UserError: the file cannot be written.
    """
    tensors = {name: value.detach().contiguous() for name, value in model.state_dict().items()}
    for name, names in (("entities", graph.names), ("relations", graph.relation_names)):
        tensors[f"names.{name}"] = torch.from_numpy(np.frombuffer(names.blob, np.uint8).copy())
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        save_file(tensors, path, {"format": FORMAT, "config": json.dumps(asdict(config))})
    except OSError as error:
        raise UserError(f"Cannot write {path}: {error.strerror}. Give another path.") from error


def load_model(path: Path) -> StoredModel:
    """Read a model that `save_model` wrote.

    Raises:
        UserError: there is no such file, it is incomplete, or it holds something else.
    """
    if not path.is_file():
        raise UserError(f"There is no model file {path}. Write one with `save_model`.")
    try:
        with safe_open(path, "pt") as file:
            about = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise UserError(
            f"{path} is not a complete safetensors file: {error}. Fit the model again."
        ) from error
    if about.get("format") != FORMAT:
        raise UserError(
            f"{path} holds no graph embedding of KnowArm (format {about.get('format')!r}, expected "
            f"{FORMAT!r}). Make one with `knowarm knowledge fit GRAPH --out FILE`."
        )
    config = from_dict(KgeConfig, json.loads(about["config"]))
    entities, relations = (
        tuple(tensors.pop(f"names.{kind}").numpy().tobytes().split(SEPARATOR)[:-1])
        for kind in ("entities", "relations")
    )
    model = new_model(config, len(entities), len(relations))
    model.load_state_dict(tensors)
    return StoredModel(
        config=config,
        model=model,
        entities=tuple(name.decode() for name in entities),
        relations=tuple(name.decode() for name in relations),
    )
