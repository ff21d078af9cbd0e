"""Check of the installed packages against a file of requirements; `gpu.sh` calls it.

    python benchmarks/gpu_versions.py benchmarks/gpu-requirements.txt cuda

On device "cpu", numba-cuda is not needed and other versions than the required ones are allowed.
"""

import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import torch
from packaging.requirements import Requirement


def problems(lines: list[str], device: str) -> tuple[list[str], list[str]]:
    """Print the installed versions; return the errors and the warnings."""
    errors, warnings = [], []
    for line in lines:
        requirement = Requirement(line)
        if device == "cpu" and requirement.name == "numba-cuda":
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
    path, device = sys.argv[1:]
    print(f"python {sys.version.split()[0]} at {sys.executable}")
    print(f"torch {torch.__version__}, CUDA {torch.version.cuda}")
    lines = [line.split("#")[0].strip() for line in Path(path).read_text().splitlines()]
    errors, warnings = problems([line for line in lines if line], device)
    if device == "cuda" and not torch.cuda.is_available():
        errors.append("torch finds no GPU")
    if warnings:
        print(f"other versions: {'; '.join(warnings)}")
    if errors:
        sys.exit(f"cannot continue: {'; '.join(errors)}. {path} says how to get the wheels.")


if __name__ == "__main__":
    main()
