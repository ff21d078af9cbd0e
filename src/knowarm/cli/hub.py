"""``knowarm hub``: runs, grounding networks and studies on the Hugging Face Hub."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from knowarm.cli.tables import FolderPath
from knowarm.errors import shell_command
from knowarm.experiment.hub import pull_from_hub, push_to_hub

RepoId = Annotated[Positional[str], arg(metavar="OWNER/NAME")]


@dataclass(frozen=True, kw_only=True)
class Push:
    """Upload a run, a grounding network or a packed study, with a model card."""

    path: Annotated[Positional[Path], arg(metavar="PATH")]
    """Run folder, .safetensors network or .tar.xz pack."""
    repo_id: RepoId
    """Repository; it is made if there is none."""
    private: bool = False
    """Make a new repository visible to its owner only."""

    def run(self) -> None:
        """Upload and print the address."""
        address = push_to_hub(self.path, self.repo_id, private=self.private)
        print(f"Uploaded {self.path} to {address}")


@dataclass(frozen=True, kw_only=True)
class Pull:
    """Download a repository."""

    repo_id: RepoId
    """Repository."""
    revision: str | None = None
    """Branch, tag or commit. Default: the main branch."""
    to: FolderPath = None
    """Folder. Default: the Hub's cache."""

    def run(self) -> None:
        """Download and print the folder."""
        path = pull_from_hub(self.repo_id, revision=self.revision, to=self.to)
        print(f"Downloaded {self.repo_id} to {path}")
        if (path / "config.json").exists():
            print(f"Evaluate it with: {shell_command('evaluate', path)}")


HUB = {"push": Push, "pull": Pull}
"""Commands of the group `knowarm hub`, by name."""
