"""Check of the installed packages against files of requirements; `gpu.sh` calls it.

    python benchmarks/gpu_versions.py cuda gpu-requirements.txt gpu-machine.txt

On device "cpu", numba-cuda and its compiler are not needed and other versions than the required
ones are allowed.
"""

import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import torch
from packaging.requirements import Requirement

ONLY_CUDA = ("numba-cuda", "nvidia-nvvm")
"""Packages that the device "cpu" does not need."""


def problems(lines: list[str], device: str) -> tuple[list[str], list[str]]:
    """Print the installed versions; return the errors and the warnings."""
    errors, warnings = [], []
    for line in lines:
        requirement = Requirement(line)
        if device == "cpu" and requirement.name in ONLY_CUDA:
            continue
        try:
            found = version(requirement.name)
        except PackageNotFoundError:
            print(f"{requirement.name} is missing")
            errors.append(f"{requirement.name} is not installed")
            continue
        print(f"{requirement.name} {found}")
        if found not in requirement.specifier:
            text = f"{requirement.name} is {found}, not {requirement.specifier}"
            (warnings if device == "cpu" else errors).append(text)
    return errors, warnings


def main() -> None:
    device, *paths = sys.argv[1:]
    print(f"python {sys.version.split()[0]} at {sys.executable}")
    print(f"torch {torch.__version__}, CUDA {torch.version.cuda}")
    text = "\n".join(Path(path).read_text() for path in paths)
    lines = [line.split("#")[0].strip() for line in text.splitlines()]
    errors, warnings = problems([line for line in lines if line], device)
    if device == "cuda" and not torch.cuda.is_available():
        errors.append("torch finds no GPU")
    if warnings:
        print(f"other versions: {'; '.join(warnings)}")
    if errors:
        sys.exit(f"cannot continue: {'; '.join(errors)}. gpu_pack.py packs those of {paths[0]}.")


if __name__ == "__main__":
    main()
