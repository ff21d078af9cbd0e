"""``knowarm doctor``: checks of this installation, or of a robot description."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from knowarm.cli.tables import FilePath, check_json_path, print_table, write_json_table
from knowarm.errors import UserError
from knowarm.experiment.installation_check import check_installation
from knowarm.world.config import EnvConfig
from knowarm.world.robot_check import check_robot


@dataclass(frozen=True, kw_only=True)
class Doctor:
    """Check this installation, or a robot of your own with its target objects."""

    robot: Annotated[str | None, tyro.conf.arg(metavar="ROBOT", help_behavior_hint="")] = None
    """Robot to check instead of the installation: a name, TOML description or MJCF file."""
    targets: tuple[str, ...] = EnvConfig().targets
    """Objects the robot should reach, by name or TOML file."""
    runs: Path = Path("runs")
    """Output folder of training runs, checked for free disk space."""
    json: FilePath = None
    """Also write the checks to this JSON file."""

    def run(self) -> None:
        """Run the checks and print them.

        Raises:
            UserError: at least one check failed.
        """
        check_json_path(self.json)
        if self.robot is None:
            checks, what = check_installation(self.runs), "installation"
        else:
            checks, what = check_robot(self.robot, self.targets), f"robot {self.robot}"
        rows = [["ok" if c.ok else "FAILED", c.name, c.found] for c in checks]
        print_table(f"Checks of the {what}", ["result", "check", "found"], rows)
        write_json_table(self.json, {"what": what, "checks": [vars(check) for check in checks]})
        failed = [check for check in checks if not check.ok]
        if failed:
            remedies = " ".join(f"{check.name}: {check.remedy}" for check in failed)
            raise UserError(f"{len(failed)} of {len(checks)} checks failed. {remedies}")
