"""Run folder: the files of one training run.

Layout of ``runs/<experiment>/<seed>/``::

    config.json            the resolved ExperimentConfig
    provenance.json        versions, commit, machine, policy sizes, parameter counts, knowledge
    knowledge.safetensors  the knowledge table (F, K), one row per facet or query
    graphs/                copies of the user's graphs; the originals are not read again
    descriptions/          likewise of robots and objects, with their MJCF files and meshes
    perception.safetensors the grounding network, for agents that have one
    metrics.csv            one row per update (PPO) or log interval (A3C)
    evaluations.csv        one row per interim evaluation
    tensorboard/           the same curves, where TensorBoard is installed
    checkpoints/           latest, previous, best
    evaluation/<label>/    post-training evaluations
"""

import hashlib
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import save

from knowarm.config import differences, from_dict, to_dict
from knowarm.errors import Argument, UserError
from knowarm.experiment.config import ExperimentConfig, StopWhen
from knowarm.experiment.csv_log import number_in, read_csv, writing
from knowarm.experiment.knows import answers_by_graph
from knowarm.experiment.provenance import CHANGING, Provenance, provenance
from knowarm.experiment.run_inputs import copy_input, is_copy_of, with_inputs
from knowarm.experiment.summary import Summary
from knowarm.perception.config import GroundingSpec
from knowarm.perception.grounding import GroundingNetwork
from knowarm.reading import (
    digest,
    read_arrays,
    read_bytes,
    read_json,
    reading,
    refuse_links,
    replacing,
    write_json,
)
from knowarm.world.description import SUFFIX, check_trusted, distrust, trust

FORMAT = 1
"""Version of the run folder's layout."""
PERCEPTION_FILE = "perception.safetensors"
"""Name of the module's file in a run folder."""
RUN_FILES = (
    "config.json",
    "provenance.json",
    "knowledge.safetensors",
    "graphs/**/*",
    "descriptions/**/*",
    "evaluation/*/summary.json",
)
"""Patterns of the files that describe a run and its evaluations."""
POLICY_FILES = ("checkpoints/best/*", PERCEPTION_FILE)
"""Patterns of the files of its best policy."""


class RunExistsError(UserError):
    """A folder in which a new run is to start already holds one."""


@dataclass
class RunFolder:
    """The files of one run in the folder ``path``."""

    path: Path

    def __post_init__(self) -> None:
        self.config_path = self.path / "config.json"
        self.provenance_path = self.path / "provenance.json"
        self.knowledge_path = self.path / "knowledge.safetensors"
        self.checkpoints = self.path / "checkpoints"
        self.tensorboard = self.path / "tensorboard"
        self.metrics_path = self.path / "metrics.csv"
        self.evaluations_path = self.path / "evaluations.csv"

    @classmethod
    def create(cls, path: Path) -> "RunFolder":
        """Make a new, empty run folder."""
        folder = cls(path)
        if folder.config_path.exists():
            raise RunExistsError(
                f"{path} already holds a run. Pass ",
                Argument("resume", True),
                " to continue it, or another seed.",
            )
        path.mkdir(parents=True, exist_ok=True)
        return folder

    @classmethod
    def open(cls, path: Path | str) -> "RunFolder":
        """Open an existing run folder, of a format that can be read, without links out of it."""
        folder = cls(Path(path))
        if not folder.config_path.is_file():
            what = "does not exist"
            give = "Give RUNS/EXPERIMENT/SEED of a training; its last line names the folder."
            if folder.path.is_dir():
                what = "has no config.json"
                inside = sorted(folder.path.glob("**/config.json"))
                if inside:
                    give = f"Give a run, such as {inside[0].parent}."
            elif folder.path.exists():
                what = "is no folder"
            raise UserError(f"{path} is not a run folder: it {what}. {give}")
        refuse_links(folder.path)
        version = folder.config().get("format")
        if version != FORMAT:
            raise UserError(
                f"{path} was written in run format {version!r}; this version reads format "
                f"{FORMAT}. Read it with the version named in its provenance.json."
            )
        return folder

    @property
    def has_checkpoint(self) -> bool:
        """Whether training can resume; a damaged checkpoint counts."""
        latest = self.checkpoints / "latest"
        return latest.is_dir() or (self.checkpoints / "previous").is_dir()

    def evaluation(self, label: str) -> Path:
        """Folder of one post-training evaluation."""
        return self.path / "evaluation" / label

    def set_evaluations_aside(self, step: int) -> None:
        """Rename the folder of evaluations to ``evaluation-at-<step>``: the training goes on."""
        path = self.path / "evaluation"
        if path.is_dir():
            with writing(path):
                shutil.copytree(path, f"{path}-at-{step}", dirs_exist_ok=True)
                shutil.rmtree(path)

    def config(self) -> dict[str, Any]:
        """Read the resolved configuration as JSON values, with the folder's copies of inputs.

        Raises:
            UserError: it names the description of a robot or object that the user has not named.
        """
        values = read_json(self.config_path)
        with reading(self.config_path, "Restore the file."):  # nested too deep
            return with_inputs(values, self._kept_input)

    def experiment(self) -> ExperimentConfig:
        """Read the configuration that the run was started with."""
        values = self.config()
        values.pop("format", None)
        return from_dict(ExperimentConfig, values)

    def write_experiment(self, config: ExperimentConfig) -> None:
        """Write the configuration and its inputs; a folder with a configuration holds a run.

        A run that resumes with its copy of an input keeps the name of the original.
        """
        trust(to_dict(config))  # the user's, or checked when it was read
        begun = read_json(self.config_path) if self.config_path.exists() else {}
        names: dict[str, str] = {}  # of the originals, by copy
        with_inputs(begun, lambda name: names.setdefault(str(self._copy(name)), name))

        def kept(name: str) -> str:
            name = names.get(name, name)
            copy_input(name, self._copy(name))
            return name

        values = with_inputs(to_dict(config), kept)
        write_json(self.config_path, {"format": FORMAT, **values})

    def _copy(self, name: str) -> Path:
        """Where the copy of an input is; inputs of one name lie in folders of their own."""
        number = hashlib.sha256(str(Path(name)).encode()).hexdigest()[:8]
        kind = "descriptions" if name.endswith(SUFFIX) else "graphs"
        return self.path / kind / number / Path(name).name

    def _kept_input(self, name: str) -> str:
        """Return the path of the copy of an input; of a description, where it has none.

        A copy of a description is read while it equals a trusted original; no trust is granted.
        """
        kept = str(self._copy(name))
        if not name.endswith(SUFFIX):
            return kept
        if not Path(kept).exists():
            kept = name
        if distrust(kept) and (distrust(name) or self.copy_of(name) != kept):
            check_trusted(kept, self.config_path)
        return kept

    def copy_of(self, name: str) -> str:
        """Return the path of the copy of an input; of the input, where it has none or differs."""
        copy = self._copy(name)
        if not copy.exists():
            return name
        is_kept = not Path(name).exists() or is_copy_of(copy, name)
        return str(copy) if is_kept else name

    def checkpoint_fact(self, name: str, missing: int) -> int:
        """Return a number that the latest checkpoint states."""
        for checkpoint in ("latest", "previous"):
            with suppress(UserError, KeyError, TypeError, ValueError, OverflowError):
                meta = read_json(self.checkpoints / checkpoint / "meta.json")
                return int(meta["facts"][name])
        return missing

    @property
    def steps_trained(self) -> int:
        """Environment steps that a run took of those it was to take; all, if it does not say."""
        config = self.experiment()
        total = config.total_steps
        if config.stop_when:
            return total
        return min(total, self.checkpoint_fact("step", total))

    def ended_early_at(self, rule: StopWhen | None) -> int | None:
        """Return the step at which an early end was reached, or None."""
        if rule is None or not self.evaluations_path.exists():
            return None
        curve = []
        for row in read_csv(self.evaluations_path):
            step = number_in(row, "step")
            success = number_in(row, "success")
            if step is not None and success is not None:
                curve.append((int(step), success))
        return rule.met_at(curve)

    def provenance(self) -> Provenance:
        """Read what a run was trained with, and on."""
        with reading(self.provenance_path, "Restore the file."):
            return from_dict(Provenance, read_json(self.provenance_path))

    def note_resumption(self, step: int, algorithm: Mapping[str, Any]) -> str:
        """Store versions, commit, machine and options from a step on; return what is another."""
        stored = self.provenance()
        here = to_dict(provenance(algorithm=algorithm))
        with reading(self.provenance_path, "Restore the file."):
            last = stored.resumed[-1] if stored.resumed else to_dict(stored)
            before = {name: last[name] for name in CHANGING}
        now = {name: here[name] for name in CHANGING}
        different = differences(before, now)
        if different:
            resumed = (*stored.resumed, {"step": step, **now})
            write_json(self.provenance_path, to_dict(replace(stored, resumed=resumed)))
        pairs = different.items()
        return "; ".join(f"{name} {old} | {new}" for name, (old, new) in pairs)

    def summaries(self) -> list[Summary]:
        """Read the summaries of the post-training evaluations, by label."""
        files = sorted(self.path.glob("evaluation/*/summary.json"))
        return [Summary.read(file.parent) for file in files]

    @property
    def digest(self) -> str:
        """SHA-256 of all files that decide what its best policy does and declares."""
        files = sorted((self.checkpoints / "best").glob("*.safetensors"))
        others = (
            "config.json",
            "provenance.json",
            "knowledge.safetensors",
            PERCEPTION_FILE,
        )
        files += filter(Path.is_file, map(self.path.joinpath, others))
        digests = [hashlib.sha256(read_bytes(file)).digest() for file in files]
        return digest(b"".join(digests))

    def write_knowledge(self, table: np.ndarray) -> None:
        """Store the knowledge table (F, K), float32."""
        with replacing(self.knowledge_path) as temporary:
            temporary.write_bytes(save({"table": np.ascontiguousarray(table)}))

    def knowledge(self) -> np.ndarray:
        """Read the knowledge table (F, K), float32, that the policy was trained with."""
        remedy = "Restore the file or train again."
        with reading(self.knowledge_path, remedy):
            table = read_arrays(self.knowledge_path, remedy=remedy)["table"]
            is_matrix = table.ndim == 2 and table.dtype == np.float32
            if not is_matrix or not np.isfinite(table).all():
                raise ValueError("its table must be a matrix of finite float32 numbers")
            return table


def network_for_training(
    config: ExperimentConfig,
    resumed: RunFolder | None,
    file: Path | str | None,
) -> GroundingNetwork | None:
    """Return the grounding network of a run, of a file or in a folder to resume, or None."""
    network = None if file is None else given_network(config, file)
    if resumed is not None and (resumed.path / PERCEPTION_FILE).exists():
        stored = stored_network(config, resumed)
        if network is not None and network.to_bytes() != stored.to_bytes():
            raise UserError(
                f"{resumed.path} was trained with another grounding network than {file}. Resume "
                "without perception, or pass another runs folder or seed to start a new run."
            )
        network = stored
    if network is not None:
        needed = GroundingSpec.of(config.env, network.spec.config)
        network.spec.check_fits(config.env, needed.facets)
    return network


def check_network(
    config: ExperimentConfig,
    network: GroundingNetwork,
    table: np.ndarray,
) -> None:
    """Check that a given network compares the places of an image with an agent's vectors.

    One that is given the answers of a graph compares none.
    """
    is_same = np.array_equal(network.knowledge.numpy(), table)
    if not is_same and not answers_by_graph(config.knows):
        raise UserError(
            "The given grounding network was trained with other knowledge of the queries than the "
            f"agent {config.agent!r} has. Give one of the same agent and graph, or leave "
            "perception out."
        )


def given_network(config: ExperimentConfig, path: Path | str) -> GroundingNetwork:
    """Read the network that is given for an experiment, which must use one."""
    if config.knows.grounding is None:
        raise UserError(
            f"Agent {config.agent!r} has no grounding network: leave perception out, or take an "
            "agent that has one, such as answers."
        )
    return GroundingNetwork.read(Path(path))


def stored_network(config: ExperimentConfig, folder: RunFolder) -> GroundingNetwork:
    """Read the network that a run folder keeps, and check that it is the run's."""
    path = folder.path / PERCEPTION_FILE
    with reading(path, "Restore the file, or train again."):
        data = path.read_bytes()
        if digest(data) != (folder.provenance().perception or {})["digest"]:
            raise ValueError("it is not the network that this run was trained with")
        return GroundingNetwork.from_bytes(data, path)
