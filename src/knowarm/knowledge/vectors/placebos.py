"""The slots of the real embedding go in; slots of the same shape that mean nothing come out."""

import numpy as np

from knowarm.knowledge.graph import KnowledgeGraph


def zeros(slots: np.ndarray, seed: int) -> np.ndarray:
    """Return zeros (S, D): the network's shape without any input."""
    del seed
    return np.zeros_like(slots)


def random(slots: np.ndarray, seed: int) -> np.ndarray:
    """Return normal noise (S, D), each slot as long as the real one."""
    noise = np.random.default_rng(seed).standard_normal(slots.shape)
    length = np.linalg.norm(slots, axis=1, keepdims=True)
    return (noise * (length / np.linalg.norm(noise, axis=1, keepdims=True))).astype(np.float32)


def onehot(slots: np.ndarray, seed: int) -> np.ndarray:
    """Return the slot's number as a one-hot (S, D), as long as the real slot: identity, no more."""
    del seed
    hot = np.zeros_like(slots)
    places = np.arange(len(slots))
    hot[places, places] = np.linalg.norm(slots, axis=1)
    return hot


def learned(slots: np.ndarray, seed: int) -> np.ndarray:
    """Return the slot's number as a plain one-hot (S, D), for a policy that learns the vectors."""
    del seed
    return np.eye(*slots.shape, dtype=np.float32)


SLOT_PLACEBOS = {"zeros": zeros, "random": random, "onehot": onehot, "learned": learned}
"""Placebos that replace the numbers of the slots."""

GRAPH_PLACEBOS = ("shuffled", "wrong-object")
"""Placebos that go through the real vectors with a false graph or a false object."""

PLACEBOS = (*SLOT_PLACEBOS, *GRAPH_PLACEBOS)


def shuffle_tails(graph: KnowledgeGraph, seed: int) -> KnowledgeGraph:
    """Permute the tails within each relation: every count stays, no fact does.

    Triples that come out twice collapse into one.
    """
    generator = np.random.default_rng(seed)
    tails = graph.tails.copy()
    for relation in np.unique(graph.relations):
        rows = np.flatnonzero(graph.relations == relation)
        tails[rows] = tails[generator.permutation(rows)]
    triples = np.stack([graph.heads, graph.relations, tails], axis=1)
    return KnowledgeGraph(
        graph.names, graph.relation_names, triples, nodes=graph.nodes, labels=graph.labels
    )
