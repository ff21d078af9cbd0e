"""Watches over a robot's inputs: who publishes them, whose joints they are, and repeated images."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knowarm.arrays import Floats

FROZEN = 4.0  # Motion of a joint that must change the image, in MPI
BLIND_STEPS = 12  # Changed commands without a new image
MOST_IMAGES = 1000  # Images that are remembered


class Publisher(NamedTuple):
    """A publisher of a topic: its message type, and whether its quality of service connects."""

    kind: str
    connects: bool = True


def unheard(topic: str, kind: str, publishers: Iterable[Publisher]) -> str:
    """Say which publisher of a topic cannot be heard by a subscription of a message type."""
    for publisher in publishers:
        if publisher.kind != kind:
            return f"a program publishes {publisher.kind} to {topic}, and not {kind}"
        if not publisher.connects:
            return f"the quality of service of a publisher of {topic} does not connect"
    return ""


class ImageWatch:
    """Notices images that do not change although the arm is commanded to move.

    Images of a camera never repeat to the byte. Those of a simulator do where the arm returns to a
    pose, so that a repeated image counts only with another pose, or after many commands.
    """

    def __init__(self, mpi: float) -> None:
        self._mpi = mpi
        self._poses: dict[int, Floats] = {}  # hash of every image, and its first pose
        self._command: Floats | None = None
        self._steps = 0  # changed commands since the last new image

    def commanded(self, targets: Floats) -> None:
        """Take the joint targets (J,) that are sent."""
        if self._command is None or (targets != self._command).any():
            self._steps += 1
        self._command = targets.copy()

    def problem(self, image: NDArray[np.uint8], angles: Floats) -> str:
        """Say whether an image, seen at joint angles (J,), is one from before the arm moved."""
        key = hash(image.tobytes())
        if key not in self._poses:
            self._poses[key] = angles.copy()
            self._steps = 0
        if len(self._poses) > MOST_IMAGES:
            del self._poses[next(iter(self._poses))]
        motion = np.abs(angles - self._poses[key]).max()
        if motion <= FROZEN * self._mpi and self._steps < BLIND_STEPS:
            return ""
        return "the image is the same as before the arm moved"


class SourceWatch:
    """Notices joints whose angles come from several programs, as when two robots publish them."""

    def __init__(self, joints: Sequence[str], memory_s: float) -> None:
        self._memory_s = memory_s
        self._told: dict[str, dict[str, float]] = {name: {} for name in joints}

    def tell(self, names: Iterable[str], source: str, now_s: float) -> None:
        """Take the names that a source sends."""
        for name in names:
            if name in self._told:
                self._told[name][source] = now_s

    def problem(self, now_s: float) -> str:
        """Say which joint several sources have sent of late."""
        for name, sources in self._told.items():
            recent = [s for s in sources.values() if now_s - s <= self._memory_s]
            if len(recent) > 1:
                return f"of {name} come from {len(recent)} programs"
        return ""
