"""``knowarm doctor``: this installation, or a robot, goes in; what to mend comes out."""

from dataclasses import dataclass
from pathlib import Path

from knowarm.cli.tables import check_json_path, print_table, write_json_table
from knowarm.errors import UserError
from knowarm.experiment.doctor import check_installation
from knowarm.world.robot_check import check_robot
from knowarm.world.objects import TARGETS


@dataclass(frozen=True, kw_only=True)
class Doctor:
    """Check this installation, or a robot and objects of your own."""

    robot: str | None = None
    """Robot to check: a name, a TOML description, or a bare MJCF file."""
    targets: tuple[str, ...] = tuple(TARGETS)
    """Objects the robot should reach, by name or TOML file."""
    runs: Path = Path("runs")
    """Folder that trainings would write to."""
    json: Path | None = None
    """Also write the checks to this JSON file."""

    def run(self) -> None:
        """Look, print, and fail if anything is to be mended."""
        check_json_path(self.json)
        if self.robot is None:
            checks, what = check_installation(self.runs), "installation"
        else:
            checks, what = check_robot(self.robot, self.targets), f"robot {self.robot}"
        rows = [["ok" if c.ok else "MEND", c.name, c.found] for c in checks]
        print_table(f"Doctor: {what}", ["", "checked", "found"], rows)
        write_json_table(self.json, {"what": what, "checks": [vars(check) for check in checks]})
        ill = [check for check in checks if not check.ok]
        if ill:
            remedies = " ".join(f"{check.name}: {check.remedy}" for check in ill)
            raise UserError(f"{len(ill)} of {len(checks)} checks failed. {remedies}")


COMMAND = Doctor
