"""Shipped policies: ``zoo/NAME`` in this folder, in a clone, in the package or on the Hub."""

import logging
from pathlib import Path

from knowarm.errors import UserError, unknown_name
from knowarm.experiment.hub import pull_from_hub
from knowarm.experiment.run_folder import RunFolder
from knowarm.reading import read_json

log = logging.getLogger("knowarm.experiment")

POLICIES: dict[str, str] = read_json(Path(__file__).with_name("zoo.json"))
"""Shipped policies by name: first half of the digest of the files that decide what each does."""
PACKAGED = "zoo/irb120-choose-answers-fast"
"""The one that the wheel holds."""
HUB_OWNER = "knowarm"
"""Owner of their repositories on the Hub."""
PACKAGE = Path(__file__).parents[1]
FOLDERS = {"a clone": PACKAGE.parents[1] / "zoo", "the package": PACKAGE / "zoo"}
"""Where they are looked for before the Hub."""


def open_run(path: Path | str) -> RunFolder:
    """Open a run folder, or a shipped policy by ``zoo/NAME``, and say where that comes from.

    Raises:
        UserError: there is no such run or policy, or the one on the Hub is not the shipped one.
    """
    name = shipped_name(path)
    if name is None:
        return RunFolder.open(path)
    if name not in POLICIES:
        raise unknown_name("shipped policy", name, POLICIES)
    for source, parent in FOLDERS.items():
        folder = parent / name
        if folder.is_dir():
            log.warning("%s is that of %s: %s", path, source, folder)
            return RunFolder.open(folder)
    repository = f"{HUB_OWNER}/{name}"
    try:
        folder = pull_from_hub(repository)
    except UserError as error:
        raise UserError(
            f"{path} is neither in this folder nor in the package: {error} The package holds "
            f"{PACKAGED}, and a clone of KnowArm all of {', '.join(POLICIES)}."
        ) from error
    log.warning("%s is that of the Hub, %s: %s", path, repository, folder)
    run = RunFolder.open(folder)
    if not run.digest.startswith(POLICIES[name]):
        raise UserError(
            f"{repository} of the Hub is not the policy that KnowArm ships as {path}: its files "
            f"differ. To use it nevertheless, give its folder, {folder}."
        )
    return run


def is_packaged(folder: Path) -> bool:
    """Return whether a run folder is part of the installed package, which nobody writes to."""
    package = FOLDERS.get("the package")
    return package is not None and package in folder.parents


def shipped_name(path: Path | str) -> str | None:
    """Return NAME of ``zoo/NAME``; None for other paths, and where that is a folder here."""
    folder = Path(path)
    is_shipped = folder.parent == Path("zoo") and not folder.exists()
    return folder.name if is_shipped else None
