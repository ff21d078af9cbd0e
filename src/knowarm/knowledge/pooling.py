"""Pooling: from the vectors of a sentence's labels to one slot."""

from collections.abc import Sequence

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.config import KnowledgeConfig, Pooling
from knowarm.knowledge.sentence import Part
from knowarm.knowledge.vectors.source import Coverage, Found, VectorLookup

SIF_A = 1e-3
"""The constant of SIF's weight a / (a + p)."""


def pool(found: Sequence[Found], pooling: Pooling, centre: np.ndarray | float = 0.0) -> np.ndarray:
    """Pool the vectors of labels into one, (D,) float64.

    mean: sum_w v_w / n;  sif: sum_w a / (a + p(w)) v_w / n  (Arora, Liang and Ma 2017, eq. 3).

    Args:
        found: vectors and frequencies of each label.
        pooling: "mean" or "sif".
        centre: subtracted from each vector first, (D,) or 0.
    """
    vectors = np.concatenate([f.vectors for f in found]).astype(np.float64) - centre
    if not len(vectors):
        return np.zeros(vectors.shape[1])
    if pooling == "mean":
        return vectors.mean(axis=0)
    frequencies = np.concatenate([f.frequencies for f in found])
    return (vectors * (SIF_A / (SIF_A + frequencies))[:, None]).mean(axis=0)


def slot_vector(
    parts: Sequence[Part],
    colour: str | None,
    lookup: VectorLookup,
    config: KnowledgeConfig,
    centre: np.ndarray | float,
    hue_centre: np.ndarray | float,
    coverage: Coverage,
) -> np.ndarray:
    """Compute the vector of one slot, (D,) float64.

    Args:
        parts: the slot's sentence.
        colour: the graph's name of the slot's colour, or None.
        lookup: the opened source.
        config: pooling, colour share and norm.
        centre: subtracted from each vector, (D,) or 0.
        hue_centre: subtracted from the colour where it has a share of its own, (D,) or 0.
        coverage: records how labels were found.
    """
    own = [p for p in parts if p.name == colour] if config.colour_share is not None else []
    rest = [p for p in parts if p not in own]
    vector = pool([lookup.find(p, coverage) for p in rest], config.pooling, centre)
    if own and config.colour_share is not None:
        hue = pool([lookup.find(own[0], coverage)], config.pooling, hue_centre)
        length = np.linalg.norm(vector)
        vector = (1 - config.colour_share) * _unit(vector) + config.colour_share * _unit(hue)
        vector = vector * length
    if config.slot_norm is not None:
        vector = _unit(vector) * config.slot_norm
    return vector


def centre_of(lookup: VectorLookup, parts: Sequence[Part]) -> np.ndarray:
    """Return the mean vector of labels, (D,) float64; labels that are not found are skipped."""
    found = []
    for part in parts:
        try:
            found.append(lookup.find(part, Coverage()).vectors)
        except UserError:
            continue
    vectors = np.concatenate([np.empty((0, lookup.dim), np.float32), *found])
    return vectors.mean(axis=0, dtype=np.float64) if len(vectors) else np.zeros(lookup.dim)


def _unit(vector: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vector)
    if length == 0:
        raise UserError(
            "A slot's vector is zero, so it cannot be scaled: no word of its sentence is known. "
            "Give aliases, or set on_missing to 'hash'."
        )
    return vector / length
