"""A file of requirements goes in; the versions that are installed, or what is amiss, come out.

    python benchmarks/gpu_versions.py benchmarks/gpu-requirements.txt cuda

On the device "cpu" numba-cuda is not needed, and other versions than the required are only named.
"""

import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import torch
from packaging.requirements import Requirement


def problems(lines: list[str], device: str) -> tuple[list[str], list[str]]:
    """Print what is installed; return what keeps from going on, and what is only to be known."""
    fatal, known = [], []
    for line in lines:
        requirement = Requirement(line)
        if device == "cpu" and requirement.name == "numba-cuda":
            continue
        try:
            found = version(requirement.name)
        except PackageNotFoundError:
            print(f"{requirement.name} is missing")
            fatal.append(f"{requirement.name} is not installed")
            continue
        print(f"{requirement.name} {found}")
        if found not in requirement.specifier:
            text = f"{requirement.name} is {found}, not {requirement.specifier}"
            (known if device == "cpu" else fatal).append(text)
    return fatal, known


def main() -> None:
    path, device = sys.argv[1:]
    print(f"python {sys.version.split()[0]} at {sys.executable}")
    print(f"torch {torch.__version__}, CUDA {torch.version.cuda}")
    lines = [line.split("#")[0].strip() for line in Path(path).read_text().splitlines()]
    fatal, known = problems([line for line in lines if line], device)
    if device == "cuda" and not torch.cuda.is_available():
        fatal.append("torch finds no GPU")
    if known:
        print(f"other versions: {'; '.join(known)}")
    if fatal:
        sys.exit(f"cannot go on: {'; '.join(fatal)}. The wheels come as {path} says.")


if __name__ == "__main__":
    main()
