"""Migration of stored run files from run format 1 to 2."""

from collections.abc import Mapping
from typing import Any

from knowarm.knowledge.vectors import migrate_source

FORMAT = 2
"""Version of the run folder's layout that this version writes."""

ALGORITHM_FIELDS = {
    "trace_decay": "gae_lambda",
    "clip": "clip_range",
    "value_weight": "vf_coef",
    "entropy_weight": "ent_coef",
    "max_gradient_norm": "max_grad_norm",
    "precision": "matmul_precision",
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
        if isinstance(values.get("knowledge"), Mapping):
            migrated["knowledge"] = migrate_source(values["knowledge"])
    return migrated
