"""Training of graph embeddings: 1-vs-all cross-entropy with early stopping."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from torch.nn.functional import cross_entropy

from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.kge import KgeConfig
from knowarm.knowledge.kge.models import MODELS, KgeModel
from knowarm.knowledge.kge.rank import rank, reciprocal
from knowarm.threads import torch_threads


@dataclass(frozen=True, kw_only=True)
class Trained:
    """A trained model and the record of its training."""

    model: KgeModel = field(repr=False)
    """The model with the vectors of the best epoch."""
    epochs: int
    """Number of epochs run."""
    best_epoch: int
    """The epoch whose vectors are returned."""
    losses: tuple[float, ...] = field(repr=False)
    """Mean loss of each epoch."""
    valid_mrr: tuple[tuple[int, float], ...] = ()
    """(epoch, MRR) of each evaluation on the validation triples."""


def new_model(config: KgeConfig, entities: int, relations: int) -> KgeModel:
    """Make an untrained model.

    Raises:
        UserError: the model is unknown, or the dimension is not allowed for it.
    """
    if config.model not in MODELS:
        raise unknown_name("graph-embedding model", config.model, MODELS)
    kind = MODELS[config.model]
    if config.dim < 4 or config.dim % kind.divisor:
        even = " and even (it holds pairs)" if kind.divisor == 2 else ""
        raise UserError(f"{config.model} got dim={config.dim}; it must be at least 4{even}.")
    generator = torch.Generator().manual_seed(config.seed)
    return kind(entities, relations, config.dim, generator)


def train(
    config: KgeConfig,
    triples: np.ndarray,
    entities: int,
    relations: int,
    *,
    valid: np.ndarray | None = None,
    known: np.ndarray | None = None,
    on_epoch: Callable[[int, float, float | None], None] | None = None,
) -> Trained:
    """Train a model with cross-entropy of (h, r, ?) over all entities, in both directions.

        loss = -log softmax(score(h, r, .))_t + n3 * N3(h, r, t)

    Args:
        config: the model and its training.
        triples: (n, 3) int64.
        entities: number of entities.
        relations: number of relations.
        valid: validation triples (m, 3); None trains for all epochs.
        known: all true triples, for filtered ranks; None takes `triples` and `valid`.
        on_epoch: called with the epoch, its loss, and the validation MRR if it was evaluated.

    Raises:
        UserError: the model is unknown, the dimension is not allowed for it, or there is no triple.
    """
    if not len(triples):
        raise UserError("There is no triple to train on. Give a graph with at least a few facts.")
    if valid is not None and not len(valid):
        valid = None
    if known is None:
        known = triples if valid is None else np.concatenate([triples, valid])
    with torch_threads(config.threads):
        model = new_model(config, entities, relations)
        return _loop(model, config, triples, valid, known, on_epoch)


def _loop(
    model: KgeModel,
    config: KgeConfig,
    triples: np.ndarray,
    valid: np.ndarray | None,
    known: np.ndarray,
    on_epoch: Callable[[int, float, float | None], None] | None,
) -> Trained:
    rate = model.learning_rate if config.learning_rate is None else config.learning_rate
    n3 = model.n3 if config.n3 is None else config.n3
    optimizer = torch.optim.Adam(model.parameters(), lr=rate)
    order = torch.Generator().manual_seed(config.seed + 1)
    queries = torch.from_numpy(np.concatenate([triples, reciprocal(triples, model.relations)]))
    losses: list[float] = []
    looks: list[tuple[int, float]] = []
    best, best_epoch, kept = -1.0, 0, _copy(model)
    for epoch in range(1, config.epochs + 1):
        model.train()
        total = 0.0
        for rows in torch.randperm(len(queries), generator=order).split(config.batch_size):
            head, relation, tail = queries[rows].T
            loss = cross_entropy(
                model(head, relation), tail, label_smoothing=config.label_smoothing
            )
            if n3:
                loss = loss + n3 * model.penalty(head, relation, tail)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            total += loss.item() * len(rows)
        losses.append(total / len(queries))
        mrr = None
        if valid is not None and (epoch % config.evaluate_every == 0 or epoch == config.epochs):
            mrr = rank(model, valid, known).mrr
            looks.append((epoch, mrr))
            if mrr > best:
                best, best_epoch, kept = mrr, epoch, _copy(model)
        if on_epoch is not None:
            on_epoch(epoch, losses[-1], mrr)
        if valid is not None and epoch - best_epoch >= config.patience * config.evaluate_every:
            break
    if valid is not None:
        model.load_state_dict(kept)
    return Trained(
        model=model,
        epochs=len(losses),
        best_epoch=best_epoch if valid is not None else len(losses),
        losses=tuple(losses),
        valid_mrr=tuple(looks),
    )


def _copy(model: KgeModel) -> dict[str, torch.Tensor]:
    return {name: value.detach().clone() for name, value in model.state_dict().items()}
