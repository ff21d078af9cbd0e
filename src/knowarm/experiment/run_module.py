"""Perception module of a run: given as a file, or stored in its folder."""

from pathlib import Path

from knowarm.errors import UserError
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.run_folder import RunFolder
from knowarm.perception.classifier import FacetClassifier
from knowarm.perception.grounding import GroundingNetwork
from knowarm.perception.module import PerceptionModule, digest
from knowarm.reading import reading
from knowarm.world.setting import facets_of

FILE = "perception.safetensors"
"""Name of the module's file in a run folder."""


def module_for_training(
    config: ExperimentConfig, resumed: RunFolder | None, given: Path | str | None
) -> PerceptionModule | None:
    """Return the perception module of a run, given as a file or in a folder to resume, or None."""
    module: PerceptionModule | None = None if given is None else given_module(config, given)
    if resumed is not None and (resumed.path / FILE).exists():
        stored = stored_module(config, resumed)
        if module is not None and module.to_bytes() != stored.to_bytes():
            raise UserError(
                f"{resumed.path} was trained with another perception module than {given}. Resume "
                "without perception, or pass another runs folder or seed to start a new run."
            )
        module = stored
    if config.knowledge.scope == "perceived":
        if module is None:
            raise UserError(
                "Knowledge of scope 'perceived' needs a perception module: pass perception=FILE. "
                "Make one with `knowarm perception train EXPERIMENT --out FILE`."
            )
        module.spec.check_fits(config.env, facets_of(config.env))
    return module


def given_module(config: ExperimentConfig, path: Path | str) -> FacetClassifier:
    """Read the module that is given for an experiment, which must use one."""
    if config.knowledge.scope != "perceived":
        raise UserError(
            f"Knowledge of scope {config.knowledge.scope!r} does not depend on what is perceived: "
            "leave perception out, or take an agent whose scope is 'perceived'."
        )
    return FacetClassifier.read(Path(path))


def stored_module(config: ExperimentConfig, folder: RunFolder) -> PerceptionModule:
    """Read the perception module that a run folder keeps, and check that it is the run's."""
    kind = FacetClassifier if config.grounding is None else GroundingNetwork
    path = folder.path / FILE
    with reading(path, "Restore the file, or train again."):
        data = path.read_bytes()
        if digest(data) != folder.provenance()["perception"]["digest"]:
            raise ValueError("it is not the module that this run was trained with")
        return kind.from_bytes(data, path)
