"""A run goes in; what its network was told about the objects comes out."""

from collections.abc import Mapping
from typing import Any

from knowarm.errors import UserError
from knowarm.experiment.run_folder import RunFolder
from knowarm.report.study import Run


def told(run: Run) -> Mapping[str, Any]:
    """What the run was told; nothing where the network was given no number of it (wide)."""
    try:
        given = RunFolder(run.path).knowledge().size > 0
    except UserError:
        given = True
    return (run.provenance.get("knowledge") or {}) if given else {}
