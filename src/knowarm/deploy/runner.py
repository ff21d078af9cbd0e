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

FORMAT = "knowarm-contract-2"
Model = Callable[[dict[str, np.ndarray]], Sequence[np.ndarray]]  # named inputs to outputs in order


@dataclass(frozen=True)
class Start:
    """Start of an episode, or of n: numbers and names are arrays (n,) then."""

    joints: Mapping[str, Any]  # Joint angles by name [rad]
    names: Any = None  # Row of the contract's knowledge; not read where there is only one


class JointMap:
    """Joints of the real arm, in the order of ``names``: value = scale * angle + offset.

    ``joints`` is that of a contract; without its entry ``real`` nothing is converted. Joints that
    the policy does not move, such as an open gripper, have a constant value: their scale is 0.
    ``moved`` are the names on the real arm of the policy's joints, in the policy's order.
    """

    def __init__(self, joints: Mapping[str, Any]) -> None:
        own = [{"joint": n, "name": n, "scale": 1.0, "offset": 0.0} for n in joints["names"]]
        real = joints.get("real") or own
        place = {each["joint"]: i for i, each in enumerate(real)}
        self.names = tuple(each["name"] for each in real)
        self._places = [place[name] for name in joints["names"]]
        self.moved = tuple(self.names[i] for i in self._places)
        self._offset = np.array([each["offset"] for each in real], float)
        self._scale = np.array([real[i]["scale"] for i in self._places], float)
        finite = np.isfinite([*self._offset, *self._scale]).all() and self._scale.all()
        if not finite or len({*self.names}) < len(real):
            raise ValueError("joints.real has names twice, or numbers that are not finite or 0")

    def to_real(self, angles: Any) -> np.ndarray:
        """Convert the policy's joint angles (..., J) [rad] to values of the real arm (..., R)."""
        values = np.zeros((*np.shape(angles)[:-1], len(self.names))) + self._offset
        values[..., self._places] += self._scale * angles
        return values

    def from_real(self, values: Any) -> np.ndarray:
        """Convert values of the real arm (..., R) to the policy's joint angles (..., J) [rad]."""
        found = np.asarray(values, float) - self._offset
        return found[..., self._places] / self._scale


class Runner:
    """Plays n episodes side by side, one on a robot, and then the next ones.

    Args:
        contract: the content of ``contract.json``.
        knowledge: (rows, width) float32, the content of ``knowledge.npy``.
        policy, recognition: the models; recognition is None for agents without such a network.

    Raises `ValueError` for a contract, table, input or output that is damaged or does not fit.
    ``targets`` are the joint angles that the actions have commanded, (n, J) [rad], and
    ``joint_map`` converts them to what the real arm is sent, and its readings to them.
    """

    def __init__(
        self,
        contract: dict[str, Any],
        knowledge: np.ndarray,
        policy: Model,
        recognition: Model | None = None,
    ) -> None:
        check(contract, knowledge)
        joints = contract["joints"]
        self.contract, self.joint_names = contract, tuple(joints["names"])
        self.lower, self.upper = np.array(joints["lower"]), np.array(joints["upper"])
        self.increments, self.joint_map = np.array(joints["increments"]), JointMap(joints)
        self.is_started = False
        self._table, self._policy, self._recognition = knowledge, policy, recognition

    @classmethod
    def load(cls, folder: str | Path) -> "Runner":
        """Load an exported folder: the files that the contract describes, and no others."""
        import onnxruntime

        folder = Path(folder)
        contract = json.loads((folder / "contract.json").read_text("utf-8"))
        if not isinstance(contract, dict) or contract.get("format") != FORMAT:
            raise ValueError(f"{folder} has no contract of the format {FORMAT}; export again")
        names = ["policy.onnx", "knowledge.npy"]
        names += ["recognition.onnx"] * bool(contract["recognition"])
        if set(contract["digests"]) != set(names):
            raise ValueError(f"{folder} must state digests of {', '.join(names)}; export again")
        for name in names:
            data = (folder / name).read_bytes() if (folder / name).is_file() else b""
            if hashlib.sha256(data).hexdigest() != contract["digests"][name]:
                raise ValueError(f"{folder / name} is not the exported file; export again")

        def model(name: str) -> Model:
            session = onnxruntime.InferenceSession(folder / name)
            if session.get_modelmeta().custom_metadata_map.get("contract") != fingerprint(contract):
                raise ValueError(f"{folder / 'contract.json'} is not that of {name}; export again")
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
        if len(names) != len(angles):
            raise ValueError(f"{len(angles)} episodes start, and {len(names)} have names")
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
        levels, _, _, h, c = self._policy(inputs)
        found, last = np.asarray(levels), len(self.increments) - 1
        if found.shape != self.targets.shape or found.dtype.kind not in "iu":
            raise ValueError(f"the policy gives levels {found.shape} {found.dtype}")
        if found.min() < 0 or found.max() > last or not np.isfinite([h, c]).all():
            raise ValueError(f"the policy gives levels beyond 0 to {last}, or no finite state")
        self._h, self._c, self._first = h, c, False
        self.targets = (self.targets + self.increments[levels]).clip(self.lower, self.upper)
        return levels


def fingerprint(contract: Mapping[str, Any]) -> str:
    """Return the digest of a contract that its models carry: of all but the digests of files."""
    text = json.dumps({k: v for k, v in contract.items() if k != "digests"}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def check(contract: Mapping[str, Any], knowledge: np.ndarray) -> None:
    """Raise `ValueError` for a contract or table (rows, width) by which nothing should move."""
    joints, rows = contract["joints"], contract["knowledge"]["rows"]
    names, box = joints["names"], np.array([*contract["workspace_m"].values()], float)
    lower, upper, increments = (
        np.array(joints[name], float) for name in ("lower", "upper", "increments")
    )
    sizes = [contract["control_period_s"], contract["max_episode_steps"], joints["mpi"]]
    sizes += [contract["camera"]["size"], contract["recurrent"]["size"]]
    finite = (np.isfinite(each).all() for each in (lower, upper, increments, box, sizes, knowledge))
    for is_right, what in (
        (all(finite), "numbers are finite"),
        (min(sizes) > 0, "periods, steps and sizes are larger than 0"),
        (len({*names}) == len(names) > 0, "the names of the joints differ"),
        (lower.shape == upper.shape == (len(names),), "every joint has a lower and an upper limit"),
        (np.all(lower < upper) and box.shape == (2, 3), "lower limits lie below upper ones"),
        (np.abs(increments).max(initial=0) <= joints["mpi"] * 1.000001, "no action exceeds mpi"),
        (len({*rows}) == len(rows) == len(knowledge) > 0, "every row of the table has a name"),
    ):
        if not is_right:
            raise ValueError(f"the contract is damaged: it must hold that {what}; export again")
