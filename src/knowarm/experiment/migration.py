"""Migration of stored run files: from run formats 1 and 2 to 3, and fields added since.

Files of earlier formats are converted whenever they are read; nothing is rewritten unless a run
resumes.

==================  ==================================================================
file                change from format 1 to 2
==================  ==================================================================
config.json         ``network`` -> ``policy``; fields of ``algorithm`` renamed; ``role`` added;
                    ``knowledge.source`` (and ``matches``): short name -> tagged config
provenance.json     ``network`` -> ``policy.config`` and ``policy.shape``; ``knowledge.config`` as
                    in config.json
metrics.csv         columns renamed
checkpoints         ``meta.json``: ``network.*`` -> ``policy.config.*`` and ``policy.shape.*`` in
                    the description; sums of A3C's log interval renamed as the columns
==================  ==================================================================

From format 2 to 3 the robots got another task: another start pose and MPI. Runs of earlier formats
keep theirs under the name of the robot's variant (``RobotEntry.variant_of``): in ``env`` of
``config.json`` and of an evaluation's ``summary.json``, and in the description of a checkpoint.

Fields that were added without a new format get the meaning that the earlier version had
(``earlier_values`` of the algorithms' and the vector sources' configs).
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from knowarm.errors import UserError
from knowarm.experiment.agents import AGENTS, Role
from knowarm.experiment.algorithms import ALGORITHMS
from knowarm.knowledge import migrate_source
from knowarm.reading import read_json
from knowarm.world.robots import ROBOTS

FORMAT = 3
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

COLUMNS = {"gradient_norm": "grad_norm", "kl": "approx_kl", "clipped": "clip_fraction"}
"""Columns of ``metrics.csv`` and ``evaluations.csv``: name in format 1 to name in format 2."""

ADDED_TO_DESCRIPTIONS = {"policy.config.fc_activation": "relu"}
"""Fields that descriptions of checkpoints lack if an earlier version wrote them."""

VARIANTS = {entry.variant_of: name for name, entry in ROBOTS.items() if entry.variant_of}
"""Robot in run formats 1 and 2 to the robot that has its task now."""

SHAPE_FIELDS = ("joints", "levels", "image_size", "knowledge_dim", "knowledge_slots")
"""Fields of a format 1 ``network`` that belong to the policy's shape; the others are choices."""


def migrate_config(values: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the values of a ``config.json`` to the current format.

    Args:
        values: the file's JSON object, format 1 to 3.

    Returns:
        The values in format 3 with all current fields of knowledge and algorithm whose default
        differs from what earlier versions did.
    """
    migrated = dict(values)
    if isinstance(knowledge := values.get("knowledge"), Mapping):
        migrated["knowledge"] = migrate_source(knowledge)
    if isinstance(algorithm := values.get("algorithm"), Mapping):
        if values.get("format") == 1:
            algorithm = _renamed(algorithm, ALGORITHM_FIELDS)
        entry = ALGORITHMS.get(algorithm.get("name", ""))
        migrated["algorithm"] = {**(entry.config.earlier_values if entry else {}), **algorithm}
    if values.get("format") not in (1, 2):
        return migrated
    migrated["format"] = FORMAT
    if isinstance(env := values.get("env"), Mapping):
        migrated["env"] = _migrate_env(env)
    if values["format"] == 2:
        return migrated
    migrated["role"] = _role(values)
    if isinstance(policy := migrated.pop("network", None), Mapping):
        learned = values.get("knowledge", {}).get("source") == "learned"
        encoder = {"knowledge_encoder": "learned"} if learned else {}
        migrated["policy"] = {**policy, **encoder}
    return migrated


def migrate_provenance(values: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the values of a ``provenance.json`` to the current format.

    Args:
        values: the file's JSON object, format 1 to 3.

    Returns:
        The values in format 3; values of formats 2 and 3 are returned unchanged.
    """
    migrated = dict(values)
    if isinstance(network := migrated.pop("network", None), Mapping):
        migrated["policy"] = _split(network)
    knowledge = values.get("knowledge")
    if isinstance(knowledge, Mapping) and isinstance(knowledge.get("config"), Mapping):
        migrated["knowledge"] = {**knowledge, "config": migrate_source(knowledge["config"])}
    return migrated


def migrate_evaluation(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the values of an evaluation's ``summary.json`` from format 1 to 2: the robot."""
    if summary.get("format") != 1:
        return dict(summary)
    return {**summary, "format": 2, "env": _migrate_env(summary.get("env", {}))}


def migrate_row(row: Mapping[str, str]) -> dict[str, str]:
    """Convert one row of ``metrics.csv`` or ``evaluations.csv`` to the current column names."""
    return _renamed(row, COLUMNS)


def migrate_checkpoints(folder: Path, robot: str) -> None:
    """Rewrite the ``meta.json`` of checkpoints of earlier versions, so that their run can resume.

    Args:
        folder: the run's ``checkpoints`` folder.
        robot: the run's robot, in the current format.

    Raises:
        UserError: a file cannot be written.
    """
    for path in folder.glob("*/meta.json"):
        try:
            meta = read_json(path)
            migrated = {
                **meta,
                "description": migrate_description(meta["description"], robot),
                "facts": _migrate_facts(meta["facts"]),
            }
        except (ValueError, KeyError, TypeError, AttributeError):
            continue  # damaged: reading the checkpoint reports it
        if migrated != meta:
            temporary = path.with_name("meta.json.tmp")
            try:
                temporary.write_text(json.dumps(migrated, indent=2), encoding="utf-8")
                temporary.replace(path)
            except OSError as error:
                raise UserError(
                    f"Cannot write {path}: {error.strerror or error}. The checkpoint is intact: "
                    "free disk space and resume."
                ) from error


def migrate_description(description: Mapping[str, Any], robot: str) -> dict[str, Any]:
    """Convert the description of a checkpoint (flat JSON values) to the current format.

    The description has no format of its own: its robot becomes that of the run if this is its
    variant.
    """
    migrated = {}
    for name, value in description.items():
        group, _, field = name.partition(".")
        if group == "network":
            name = f"policy.{'shape' if field in SHAPE_FIELDS else 'config'}.{field}"
        migrated[name] = value
    if any(name.startswith("policy.config.") for name in migrated):
        migrated = {**ADDED_TO_DESCRIPTIONS, **migrated}
    if VARIANTS.get(str(migrated.get("robot"))) == robot:
        migrated["robot"] = robot
    return migrated


def _migrate_env(env: Mapping[str, Any]) -> dict[str, Any]:
    """Name the variant that has the robot's task of run formats 1 and 2."""
    robot = VARIANTS.get(str(env.get("robot")))
    if robot is None:
        return dict(env)
    migrated = {**env, "robot": robot}
    if env.get("mpi_rad") == ROBOTS[robot].robot.mpi_rad:
        migrated["mpi_rad"] = None
    return migrated


def _migrate_facts(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Rename the sums of A3C's current log interval, which have the names of its columns."""
    window = facts.get("window")
    return {**facts, "window": _renamed(window, COLUMNS)} if window else dict(facts)


def _role(values: Mapping[str, Any]) -> Role:
    """Role of a format 1 agent, from the registry, or from its knowledge for other names."""
    if values.get("agent") in AGENTS:
        return AGENTS[values["agent"]].role
    knowledge = values.get("knowledge", {})
    if knowledge.get("detail") == "none":
        return "baseline"
    return "privileged" if knowledge.get("scope") == "target" else "knowledge"


def _split(network: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    return {
        "config": {name: value for name, value in network.items() if name not in SHAPE_FIELDS},
        "shape": {name: value for name, value in network.items() if name in SHAPE_FIELDS},
    }


def _renamed(values: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    return {names.get(name, name): value for name, value in values.items()}
