"""Runner: plays an exported policy with NumPy and ONNX Runtime, without PyTorch and KnowArm.

Example:
    runner = Runner.load("exported")
    runner.start({"joint_1": 0.0, ...}, knowledge="usedFor drinking")  # joint names to radians
    targets = runner.step(image)  # once per control period; the first step of an episode too
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

Model = Callable[[dict[str, np.ndarray]], Sequence[np.ndarray]]  # named inputs to outputs in order


class Runner:
    """Plays one episode after the other: joint angles once, then an image per control period.

    Args:
        contract: the content of ``contract.json``.
        knowledge: (rows, width) float32, the content of ``knowledge.npy``.
        policy, recognition: the models; recognition is None for agents without such a network.
    """

    def __init__(
        self,
        contract: dict[str, Any],
        knowledge: np.ndarray,
        policy: Model,
        recognition: Model | None = None,
    ) -> None:
        joints = contract["joints"]
        self.contract, self.joint_names = contract, tuple(joints["names"])
        self.lower, self.upper = np.array(joints["lower"]), np.array(joints["upper"])
        self.increments = np.array(joints["increments"])
        self.is_started = False
        self._table, self._policy, self._recognition = knowledge, policy, recognition

    @classmethod
    def load(cls, folder: str | Path) -> "Runner":
        """Load an exported folder, whose files must be those that the contract describes."""
        import onnxruntime

        folder = Path(folder)
        contract = json.loads((folder / "contract.json").read_text("utf-8"))
        for name, digest in contract["digests"].items():
            if hashlib.sha256((folder / name).read_bytes()).hexdigest() != digest:
                raise ValueError(f"{folder / name} is not the exported file; export again")

        def model(name: str) -> Model:
            session = onnxruntime.InferenceSession(folder / name)
            names = [each.name for each in session.get_inputs()]
            return lambda inputs: session.run(None, {name: inputs[name] for name in names})

        recognition = model("recognition.onnx") if contract["recognition"] else None
        return cls(contract, np.load(folder / "knowledge.npy"), model("policy.onnx"), recognition)

    def start(self, joints: Mapping[str, float], knowledge: str | int | None = None) -> None:
        """Start an episode at joint angles by name; ``knowledge`` is a row of the table."""
        self.is_started = False
        if missing := [name for name in self.joint_names if name not in joints]:
            raise ValueError(f"joints lack {', '.join(missing)}; got {', '.join(joints) or 'none'}")
        angles = np.array([joints[name] for name in self.joint_names], np.float64)
        slack = 0.05  # [rad]: a resting joint may lie slightly beyond its limit
        if not ((angles > self.lower - slack) & (angles < self.upper + slack)).all():
            raise ValueError(f"joint angles {angles.tolist()} are not finite and within the limits")
        about = self.contract["knowledge"]
        rows, row = about["rows"], about["default_row"] if knowledge is None else knowledge
        row = rows.index(row) if row in rows else row
        if not isinstance(row, int) or not 0 <= row < len(rows):
            raise ValueError(f"knowledge must be a row such as {rows[0]!r}, got {knowledge!r}")
        self.targets = angles.clip(self.lower, self.upper)
        self._knowledge = self._table[[row]]
        size = self.contract["recurrent"]["size"]
        self._state = [np.zeros((1, size), np.float32)] * 2
        self._first = self.is_started = True

    def step(self, image: np.ndarray) -> np.ndarray:
        """Return the joint targets (J,) that follow an image (H, W, 3) uint8 RGB."""
        size = self.contract["camera"]["size"]
        if image.shape != (size, size, 3) or image.dtype != np.uint8:
            wanted = f"({size}, {size}, 3) uint8"
            raise ValueError(f"image must be {wanted}, got {image.shape} {image.dtype}")
        if not self.is_started:
            raise ValueError("no episode has started; give the joint angles first")
        if self._first and self._recognition is not None:  # recognizes once, in the first image
            asked = {"image": image[None], "query": self._knowledge}
            (self._knowledge,) = self._recognition(asked)
        names = "image", "knowledge", "h", "c", "episode_start"
        inputs = image[None], self._knowledge, *self._state, np.array([self._first])
        action, _, _, *self._state = self._policy(dict(zip(names, inputs, strict=True)))
        self._first, self.levels = False, action[0]
        self.targets = (self.targets + self.increments[self.levels]).clip(self.lower, self.upper)
        return self.targets.copy()
