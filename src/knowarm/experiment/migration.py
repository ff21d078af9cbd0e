"""Migration of stored run files from run format 1 to 2."""

from collections.abc import Mapping
from typing import Any

FORMAT = 2
"""Version of the run folder's layout that this version writes."""

ALGORITHM_FIELDS = {
    "trace_decay": "gae_lambda",
    "clip": "clip_range",
    "value_weight": "vf_coef",
    "entropy_weight": "ent_coef",
    "max_gradient_norm": "max_grad_norm",
    "precision": "matmul_precision",
    "adam_epsilon": "adam_eps",
    "rmsprop_decay": "rmsprop_alpha",
    "rmsprop_epsilon": "rmsprop_eps",
}
"""Fields of the algorithm's config: name in format 1 to name in format 2."""


def migrate_config(values: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the values of a ``config.json`` to the current format.

    Args:
        values: the file's JSON object, format 1 or 2.

    Returns:
        The values in format 2; those of format 2 unchanged.
    """
    migrated = dict(values)
    algorithm = values.get("algorithm")
    if migrated.get("format") == 1 and isinstance(algorithm, Mapping):
        migrated["format"] = FORMAT
        migrated["algorithm"] = {
            ALGORITHM_FIELDS.get(name, name): value for name, value in algorithm.items()
        }
    return migrated


SHAPE_FIELDS = ("joints", "levels", "image_size", "knowledge_dim", "knowledge_slots")
"""Fields of the policy in a format 1 ``provenance.json`` that are fields of `PolicyShape`."""

METRICS_COLUMNS = {"gradient_norm": "grad_norm", "kl": "approx_kl", "clipped": "clip_fraction"}
"""Columns of ``metrics.csv``: name in format 1 to name in format 2."""


def migrate_policy(values: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the policy of a ``provenance.json`` (``network``) to the current format.

    Args:
        values: fields of the policy, format 1 or 2.

    Returns:
        ``config`` (fields of `PolicyConfig`) and ``shape`` (fields of `PolicyShape`).
    """
    if "shape" in values:
        return dict(values)
    return {
        "config": {name: value for name, value in values.items() if name not in SHAPE_FIELDS},
        "shape": {name: value for name, value in values.items() if name in SHAPE_FIELDS},
    }
