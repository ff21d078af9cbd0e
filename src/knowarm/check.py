"""Result of one check of an installation, a robot, its objects or its camera."""

from dataclasses import dataclass


@dataclass
class Check:
    """Result of one check."""

    name: str  # What was checked
    ok: bool  # Whether the check passed
    found: str  # What was found, with numbers
    remedy: str = ""  # How to correct it; empty if the check passed

    def __post_init__(self) -> None:
        if self.ok:
            self.remedy = ""
