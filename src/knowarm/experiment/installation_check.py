"""Checks of the installation: packages, knowledge, simulation, policy, memory, disk, GPU."""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import psutil
import torch

from knowarm.check import Check
from knowarm.errors import UserError
from knowarm.experiment.names import DEFAULT_EXPERIMENT, experiment_config
from knowarm.experiment.provenance import provenance
from knowarm.experiment.run import build
from knowarm.world.agents import Batch, OracleAgent
from knowarm.world.config import EnvConfig
from knowarm.world.envs.vector_env import ArmVectorEnv

MIN_MEMORY_GIB = 2.0
"""Free memory that training needs."""
MIN_DISK_GIB = 1.0
"""Free disk space that training needs."""


def check_installation(runs: Path) -> Iterator[Check]:
    """Check every part of the installation by using it once; ``runs`` holds run folders."""
    yield _checked("versions", _versions)
    yield _checked("knowledge", _knowledge)
    yield _checked("world", _world)
    yield _checked("policy", _policy)
    free = psutil.virtual_memory().available / 2**30
    yield Check(
        name="memory",
        ok=free >= MIN_MEMORY_GIB,
        found=f"{free:.1f} GiB free, {os.cpu_count()} cores",
        remedy=f"Training needs {MIN_MEMORY_GIB:.0f} GiB: close other programs.",
    )
    yield _disk(runs)
    has_gpu = torch.cuda.is_available()
    gpu = torch.cuda.get_device_name() if has_gpu else "none; not needed"
    yield Check(name="GPU", ok=True, found=gpu)


def _checked(name: str, check: Callable[[], str]) -> Check:
    """Run one check; any exception is its failure."""
    try:
        return Check(name=name, ok=True, found=check())
    except Exception as error:  # whatever is broken is reported, not raised
        remedy = "Install knowarm in a new virtual environment, see README.md."
        return Check(
            name=name, ok=False, found=f"{type(error).__name__}: {error}", remedy=remedy
        )


def _versions() -> str:
    versions = provenance().versions
    missing = [name for name, version in versions.items() if version is None]
    if missing:
        raise UserError(f"not installed: {', '.join(missing)}")
    return ", ".join(f"{name} {version}" for name, version in versions.items())


def _knowledge() -> str:
    embedding = build(experiment_config(DEFAULT_EXPERIMENT)).knowledge.embedding
    assert embedding is not None
    share = 100 * embedding.describe().coverage["share"]
    return f"vector of {embedding.dim} numbers, {share:.0f} % of labels covered"


def _world() -> str:
    env = ArmVectorEnv(EnvConfig(), 4)
    images, infos = env.reset(seed=0)
    agent = OracleAgent(env)
    agent.reset(Batch.of(env))
    before = infos["angle"].mean()
    for _ in range(5):
        images, _, _, _, infos = env.step(agent.act({"image": images}))
    is_moving = infos["angle"].mean() < before
    if np.ptp(images) <= 50 or not is_moving:
        raise UserError(
            "the simulation runs, but the image is uniform or the arm does not move"
        )
    return "simulation and ray caster work, without OpenGL"


def _policy() -> str:
    parts = build(experiment_config(DEFAULT_EXPERIMENT))
    policy = parts.new_policy(0)
    knowledge = torch.from_numpy(parts.knowledge.table[:1])
    image = torch.zeros(1, 64, 64, 3, dtype=torch.uint8)
    start = torch.ones(1, dtype=torch.bool)
    logits, _, _ = policy.step(image, knowledge, policy.initial_state(1), start)
    if not torch.isfinite(logits).all():
        raise UserError("the network's outputs are not finite")
    return f"{policy.parameter_counts()['total']:,} parameters, {torch.get_num_threads()} threads"


def _disk(runs: Path) -> Check:
    """Check the output folder, or its nearest parent that exists."""
    path = runs.absolute()
    folder = next(parent for parent in (path, *path.parents) if parent.exists())
    free = shutil.disk_usage(folder).free / 2**30
    writable = folder.is_dir() and os.access(folder, os.W_OK)
    return Check(
        name="output folder",
        ok=writable and free >= MIN_DISK_GIB,
        found=f"{runs}: {'writable' if writable else 'not writable'}, {free:.1f} GiB free",
        remedy="Choose another folder for runs.",
    )
