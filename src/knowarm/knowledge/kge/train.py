"""Training of graph embeddings, stopped early by filtered ranks of held-out triples; their file."""

import json
from collections import defaultdict
from collections.abc import Callable
from copy import deepcopy
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from safetensors import safe_open
from safetensors.torch import save
from torch import Generator, Tensor

from knowarm.config import from_dict
from knowarm.cores import torch_threads
from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.graph.graph import Ids, KnowledgeGraph
from knowarm.knowledge.kge import KgeConfig
from knowarm.knowledge.kge.models import MODELS, KgeModel
from knowarm.reading import reading, replacing

RANKED_AT_ONCE = 256
"""Triples whose scores are in memory at once."""

_DIVERGED = (
    "The graph embedding diverged: {}. Lower learning_rate or n3, or leave them out, and train "
    "again."
)


class Trained(NamedTuple):
    """A trained model and the record of its training."""

    model: KgeModel  # The model with the vectors of the best epoch
    epochs: int  # Number of epochs run
    best_epoch: int  # The epoch whose vectors are returned
    losses: tuple[float, ...]  # Mean loss of each epoch
    # (epoch, MRR) of each evaluation on the validation triples
    valid_mrr: tuple[tuple[int, float], ...]


@torch.no_grad()
def filtered_ranks(model: KgeModel, triples: Ids, known: Ids) -> Ids:
    """Rank true tail and head of triples (n, 3) among all entities, given all true triples (m, 3).

    Filtered: entities that complete another known triple are skipped (Bordes et al. 2013).
    Realistic: entities with the same score share a rank: 1 + #(higher) + #(equal) / 2.

    Returns:
        The ranks of the tails of all triples, then of the heads, (2 n,) float64.
    """
    model.eval()
    answers: dict[tuple[int, int], list[int]] = defaultdict(list)
    for h, r, t in both_ways(known, model.relations).tolist():
        answers[h, r].append(t)
    ranks = [np.empty(0)]
    asked = torch.from_numpy(both_ways(triples, model.relations))
    for batch in asked.split(RANKED_AT_ONCE):
        head, relation, tail = batch.T
        scores = model(head, relation)
        if not torch.isfinite(scores).all():
            raise UserError(_DIVERGED.format("the model gives a non-finite score"))
        true = scores.gather(1, tail[:, None])
        for row, (h, r, _) in enumerate(batch.tolist()):
            scores[row, answers[h, r]] = -torch.inf
        higher = (scores > true).sum(dim=1)
        equal = (scores == true).sum(dim=1)  # the true one itself was filtered too
        ranks.append((1.0 + higher + equal / 2.0).double().numpy())
    return np.concatenate(ranks)


def both_ways(triples: Ids, relations: int) -> Ids:
    """Return triples (n, 3), then (t, r + R, h) for each (h, r, t) of them, (2 n, 3) int64."""
    head, relation, tail = triples.T
    inverse = np.stack([tail, relation + relations, head], axis=1)
    return np.concatenate([triples, inverse])


def new_model(config: KgeConfig, entities: int, relations: int) -> KgeModel:
    """Make an untrained model."""
    if config.model not in MODELS:
        raise unknown_name("graph-embedding model", config.model, MODELS)
    kind = MODELS[config.model]
    if config.dim < 4 or config.dim % kind.divisor:
        even = " and even (it holds pairs)" if kind.divisor == 2 else ""
        raise UserError(
            f"{config.model} got dim={config.dim}; it must be at least 4{even}."
        )
    generator = Generator().manual_seed(config.seed)
    return kind(entities, relations, config.dim, generator)


def train(
    config: KgeConfig,
    triples: Ids,
    entities: int,
    relations: int,
    *,
    valid: Ids | None = None,
    known: Ids | None = None,
    on_epoch: Callable[[int, float, float | None], None] | None = None,
) -> Trained:
    """Train a model with cross-entropy of (h, r, ?) over all entities, in both directions.

        loss = -log softmax(score(h, r, .))_t + n3 * N3(h, r, t)

    A step takes a batch of queries (h, r), each with all its answers t: one row of scores serves
    them, and the loss stays the mean over triples.

    Without validation triples (m, 3), all epochs are trained. ``known`` are all true triples for
    filtered ranks, by default the given ones. ``on_epoch`` receives epoch, loss and validation MRR.
    """
    if not len(triples):
        raise UserError(
            "There is no triple to train on. Give a graph with at least a few facts."
        )
    if valid is None:
        valid = np.empty((0, 3), np.int64)
    if known is None:
        known = np.concatenate([triples, valid])
    with torch_threads(config.threads):
        model = new_model(config, entities, relations)
        rate = config.learning_rate or model.learning_rate
        optimizer = torch.optim.Adam(model.parameters(), lr=rate)
        order = Generator().manual_seed(config.seed + 1)
        negatives = Generator().manual_seed(config.seed + 2)
        queries = _Queries.of(both_ways(triples, relations))
        losses = []
        evaluations: list[tuple[int, float]] = []
        best_epoch = 0
        best_state = deepcopy(model.state_dict())
        for epoch in range(1, config.epochs + 1):
            model.train()
            total = 0.0
            shuffled = torch.randperm(len(queries.pairs), generator=order)
            for rows in shuffled.split(config.batch_size):
                loss, count = _loss(config, model, queries, rows, negatives)
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                total += loss.item() * count
            losses.append(total / len(queries.answers))
            if not _is_finite(torch.tensor(total), *model.parameters()):
                reason = f"its loss in epoch {epoch} is not finite"
                raise UserError(_DIVERGED.format(reason))
            mrr = None
            if not len(valid):
                best_epoch = epoch
            elif epoch % config.evaluate_every == 0 or epoch == config.epochs:
                mrr = float((1.0 / filtered_ranks(model, valid, known)).mean())
                if mrr > max(dict(evaluations).values(), default=-1):
                    best_epoch = epoch
                    best_state = deepcopy(model.state_dict())
                evaluations.append((epoch, mrr))
            if on_epoch is not None:
                on_epoch(epoch, losses[-1], mrr)
            if epoch - best_epoch >= config.patience * config.evaluate_every:
                break
        if len(valid):
            model.load_state_dict(best_state)
        return Trained(
            model, len(losses), best_epoch, tuple(losses), tuple(evaluations)
        )


def _is_finite(*values: Tensor) -> bool:
    return all(value.isfinite().all() for value in values)


class _Queries(NamedTuple):
    """Queries (h, r, ?), and all their answers one after another."""

    pairs: Tensor  # (Q, 2) int64, h and r
    counts: Tensor  # (Q,) int64, answers of each query
    answers: Tensor  # (sum of counts,) int64

    @classmethod
    def of(cls, triples: Ids) -> "_Queries":
        pairs, group = np.unique(triples[:, :2], axis=0, return_inverse=True)
        group = group.ravel()
        answers = triples[np.argsort(group, kind="stable"), 2]
        return cls(*map(torch.from_numpy, (pairs, np.bincount(group), answers)))


def _loss(
    config: KgeConfig,
    model: KgeModel,
    queries: _Queries,
    rows: Tensor,
    negatives: Generator,
) -> tuple[Tensor, int]:
    """Return the loss of some rows of the queries, and the number of their answers."""
    counts = queries.counts[rows]
    ends = queries.counts.cumsum(0)[rows]
    row = torch.repeat_interleave(torch.arange(len(rows)), counts)
    # From the position of a row's answers among those of the batch to that among all.
    shift = ends - counts.cumsum(0)
    tail = queries.answers[torch.arange(len(row)) + shift[row]]
    head, relation = queries.pairs[rows].T
    compared = None
    column = tail
    if config.negatives is not None:
        size = (config.negatives,)
        drawn = torch.randint(len(model.entity), size, generator=negatives)
        compared = torch.cat([tail, drawn]).unique()  # sorted
        column = torch.searchsorted(compared, tail)
    scores = model(head, relation, compared)
    loss = (scores.logsumexp(dim=1)[row] - scores[row, column]).mean()
    weight = model.n3 if config.n3 is None else config.n3
    if weight:
        loss = loss + weight * model.penalty(head[row], relation[row], tail)
    return loss, len(row)


def hold_out(graph: KnowledgeGraph, share: float, seed: int) -> tuple[Ids, Ids]:
    """Split the triples of a graph at random into those to train on and a share of the others.

    Every entity and relation occurs in training.
    """
    if not 0 < share < 1:
        raise UserError(
            f"The share of triples to hold out must lie between 0 and 1, got {share}."
        )
    triples = graph.triples
    rows = held_out_rows(graph, round(share * len(triples)), seed)
    return np.delete(triples, rows, axis=0), triples[rows]


def held_out_rows(graph: KnowledgeGraph, count: int, seed: int) -> list[int]:
    """Draw rows of ``graph.triples`` that training can do without, ``count`` or fewer.

    Triples are taken in a random order; one is held out only while training keeps another triple
    of its head, relation and tail.

    Raises:
        UserError: not one can be held out.
    """
    triples = graph.triples
    ends = np.bincount(triples[:, [0, 2]].ravel(), minlength=len(graph.names))
    uses = np.bincount(triples[:, 1], minlength=len(graph.relation_names))
    held: list[int] = []
    for row in np.random.default_rng(seed).permutation(len(triples)):
        if len(held) == count:
            break
        head, relation, tail = triples[row]
        if min(ends[head], ends[tail]) > 1 + (head == tail) and uses[relation] > 1:
            ends[head] -= 1
            ends[tail] -= 1
            uses[relation] -= 1
            held.append(int(row))
    if not held:
        why = "so that every entity stays in training: give a larger graph"
        if not count:
            why = "by a share below one triple: give a larger share"
        raise UserError(f"No triple of {len(triples)} can be held out {why}.")
    return held


FORMAT = "knowarm-graph-embedding-1"
AGAIN = "Fit the model again with `knowarm knowledge fit GRAPH --out FILE`."
"""Remedy for a damaged file."""


class StoredModel(NamedTuple):
    """A trained model with the names of its rows."""

    config: KgeConfig
    model: KgeModel
    entities: tuple[str, ...]
    relations: tuple[str, ...]


def save_model(
    model: KgeModel, config: KgeConfig, graph: KnowledgeGraph, path: Path
) -> None:
    """Write a model."""
    tensors = {name: value.contiguous() for name, value in model.state_dict().items()}
    for name, names in (("entities", graph.names), ("relations", graph.relation_names)):
        data = bytearray("\0".join([*names, ""]).encode())
        tensors[f"names.{name}"] = torch.frombuffer(data, dtype=torch.uint8)
    content = save(tensors, {"format": FORMAT, "config": json.dumps(asdict(config))})
    with replacing(path, "Give another path.") as temporary:
        # `save_file` raises another type of error than `OSError` when a disk is full.
        temporary.write_bytes(content)


def load_model(path: Path) -> StoredModel:
    """Read a model that `save_model` wrote."""
    if not path.is_file():
        remedy = "Write one: knowarm knowledge fit --out FILE.safetensors."
        raise UserError(f"There is no model file {path}. {remedy}")
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
        names = []
        for kind in ("entities", "relations"):
            data = tensors.pop(f"names.{kind}").numpy().tobytes()
            names.append(tuple(data.decode().split("\0")[:-1]))
        entities, relations = names
        if not _is_finite(*tensors.values()):
            raise ValueError("it contains non-finite values")
        model = new_model(config, len(entities), len(relations))
        model.load_state_dict(tensors)
    return StoredModel(config, model, entities, relations)
