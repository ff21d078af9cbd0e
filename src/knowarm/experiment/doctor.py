"""This machine goes in; a list of what is well and what is to be mended comes out."""

import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import torch

from knowarm.errors import UserError
from knowarm.experiment.build import build
from knowarm.experiment.provenance import provenance
from knowarm.experiment.registry import experiment
from knowarm.world.robot_check import Check
from knowarm.world.env import EnvConfig, ReachVectorEnv
from knowarm.world.oracle import OracleAgent

MIN_MEMORY_GIB = 2.0
MIN_DISK_GIB = 1.0


def check_installation(runs: Path) -> list[Check]:
    """Use every part of the installation once.

    Args:
        runs: the folder that trainings would write to.
    """
    return [
        _checked("versions", _versions),
        _checked("knowledge", _knowledge),
        _checked("world", _world),
        _checked("policy", _policy),
        _memory(),
        _disk(runs),
        _graphics_card(),
    ]


def _checked(name: str, look: Callable[[], str]) -> Check:
    """Run one check; whatever it raises is what is wrong."""
    try:
        return Check(name=name, ok=True, found=look())
    except Exception as error:  # a doctor reports any illness
        return Check(
            name=name,
            ok=False,
            found=f"{type(error).__name__}: {error}",
            remedy="Install knowarm anew in a fresh environment: see README.md.",
        )


def _versions() -> str:
    found = provenance()["versions"]
    missing = [name for name, version in found.items() if version is None]
    if missing:
        raise UserError(f"not installed: {', '.join(missing)}")
    return ", ".join(f"{name} {version}" for name, version in found.items())


def _knowledge() -> str:
    parts = build(experiment("irb120-full-ppo"))
    coverage = parts.embedding.describe()["coverage"]
    return f"{parts.embedding.dim} numbers, {100 * coverage['share']:.0f} % of labels known"


def _world() -> str:
    """The oracle's first steps must bring it nearer, and something must be in the image."""
    env = ReachVectorEnv(EnvConfig(), 4)
    images, infos = env.reset(seed=0)
    agent = OracleAgent(0)
    agent.start(env)
    before = infos["angle"].mean()
    for _ in range(5):
        images, _, _, _, infos = env.step(agent.act(images))
    if not np.ptp(images) > 50 or not infos["angle"].mean() < before:
        raise UserError("the simulation ran, and the image or the motion is not right")
    return "simulation and ray caster work, without OpenGL"


def _policy() -> str:
    parts = build(experiment("irb120-full-ppo"))
    policy = parts.new_policy(0)
    image = torch.zeros(1, 64, 64, 3, dtype=torch.uint8)
    knowledge = torch.from_numpy(parts.table[:1])
    patches = policy.patches(image)
    logits, _, _ = policy.step(patches, knowledge, policy.initial_state(1), torch.ones(1).bool())
    if not bool(torch.isfinite(logits).all()):
        raise UserError("the network's outputs are not finite")
    return f"{policy.parameter_counts()['total']:,} parameters, {torch.get_num_threads()} threads"


def _memory() -> Check:
    free = psutil.virtual_memory().available / 2**30
    return Check(
        name="memory",
        ok=free >= MIN_MEMORY_GIB,
        found=f"{free:.1f} GiB free, {os.cpu_count()} cores",
        remedy=f"Training wants {MIN_MEMORY_GIB:.0f} GiB: close other programs.",
    )


def _disk(runs: Path) -> Check:
    """Look at the nearest folder that exists: it is the one that would be written to."""
    folder = next(
        parent for parent in [runs.absolute(), *runs.absolute().parents] if parent.exists()
    )
    free = shutil.disk_usage(folder).free / 2**30
    writable = folder.is_dir() and os.access(folder, os.W_OK)
    return Check(
        name="output folder",
        ok=writable and free >= MIN_DISK_GIB,
        found=f"{runs}: {'writable' if writable else 'not writable'}, {free:.1f} GiB free",
        remedy="Give trainings another place with --runs.",
    )


def _graphics_card() -> Check:
    """Say what there is: training needs none."""
    if torch.cuda.is_available():
        return Check(name="GPU", ok=True, found=torch.cuda.get_device_name())
    build_of = "a build for GPUs" if torch.version.cuda else "the build for CPUs"
    return Check(
        name="GPU",
        ok=True,
        found=f"none (torch is {build_of}; Python {sys.version_info.major}."
        f"{sys.version_info.minor}); training runs on the CPU",
    )
