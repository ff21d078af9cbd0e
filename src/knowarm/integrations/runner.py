"""Runner: plays an exported policy with NumPy and ONNX Runtime, without PyTorch and KnowArm.

Example:
    runner = Runner.load("exported")
    runner.reset(Start({"joint_1": 0.0, ...}, "usedFor drinking"))  # joint names to radians
    runner.act({"image": image[None]})  # once per control period; the first step of an episode too
    runner.targets[0]  # joint targets
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

Model = Callable[[dict[str, np.ndarray]], Sequence[np.ndarray]]  # named inputs to outputs in order


@dataclass(frozen=True)
class Start:
    """Start of an episode, or of n: numbers and names are arrays (n,) then."""

    joints: Mapping[str, Any]  # Joint angles by name [rad]
    names: Any = None  # Row of the contract's knowledge; not read where there is only one


class Runner:
    """Plays n episodes side by side, one on a robot, and then the next ones.

    Args:
        contract: the content of ``contract.json``.
        knowledge: (rows, width) float32, the content of ``knowledge.npy``.
        policy, recognition: the models; recognition is None for agents without such a network.

    ``targets`` are the joint angles that the actions have commanded, (n, J) [rad].
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

    def reset(self, batch: Any) -> None:
        """Start the episodes of a `Start`, or of anything with its members."""
        self.is_started = False
        if missing := [name for name in self.joint_names if name not in batch.joints]:
            raise ValueError(f"joints lack {', '.join(missing)}; got {[*batch.joints]}")
        angles = np.atleast_2d(np.transpose([batch.joints[name] for name in self.joint_names]))
        slack = 0.05  # [rad]: a resting joint may lie slightly beyond its limit
        if not ((angles > self.lower - slack) & (angles < self.upper + slack)).all():
            raise ValueError(f"joint angles {angles.tolist()} are not finite and within the limits")
        rows = self.contract["knowledge"]["rows"]
        names = rows * len(angles) if len(rows) == 1 else np.atleast_1d(batch.names).tolist()
        if unknown := [name for name in names if name not in rows]:
            raise ValueError(f"knowledge must be a row such as {rows[0]!r}, got {unknown[0]!r}")
        self.targets = angles.clip(self.lower, self.upper)
        self._knowledge = self._table[[rows.index(name) for name in names]]
        size = self.contract["recurrent"]["size"]
        self._h = self._c = np.zeros((len(angles), size), np.float32)
        self._first = self.is_started = True

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return levels (n, J) for the images (n, H, W, 3) uint8, and add them to `targets`."""
        if not self.is_started:
            raise ValueError("no episode has started; give the joint angles first")
        image, size = observations["image"], self.contract["camera"]["size"]
        wanted = len(self.targets), size, size, 3
        if image.shape != wanted or image.dtype != np.uint8:
            raise ValueError(f"image must be {wanted} uint8, got {image.shape} {image.dtype}")
        if self._first and self._recognition is not None:  # recognizes once, in the first image
            (self._knowledge,) = self._recognition({"image": image, "query": self._knowledge})
        inputs = {"image": image, "knowledge": self._knowledge, "h": self._h, "c": self._c}
        inputs["episode_start"] = np.full(len(image), self._first)
        levels, _, _, self._h, self._c = self._policy(inputs)
        self._first = False
        self.targets = (self.targets + self.increments[levels]).clip(self.lower, self.upper)
        return levels
