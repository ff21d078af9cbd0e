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
from numpy import ndarray

FORMAT = "knowarm-contract-2"
RESTING_RAD = 0.05  # how far beyond its limit a resting joint may lie
ENDLESS = (-np.inf, np.inf)
SAMPLES = 8  # Along each side of a pixel of a rectified image
MOST_CROPPED = 0.1  # Offset of a principal point, in heights of the image
RESTING_M = 0.005  # how far beyond their limits fingers may rest
Contract = Mapping[str, Any]  # the content of contract.json, or a part of it
Arrays = Mapping[str, ndarray]
Model = Callable[[Arrays], Sequence[ndarray]]  # named inputs to outputs in order


@dataclass(frozen=True)
class Start:
    """Start of an episode, or of n: numbers and names are arrays (n,) then."""

    joints: Mapping[str, Any]  # Joint angles by name [rad]
    names: Any = None  # Row of the contract's knowledge, unless there is only one


class JointMap:
    """Joints of the real arm, in the order of ``names``: value = scale * angle + offset.

    ``joints`` is that of a contract; without its entry ``real`` nothing is converted. Joints that
    the policy does not move, such as an open gripper, have a constant value: their scale is 0.
    What is sent stays within the ``limits`` of joints that have them: of fingers.
    ``joints`` are the model's names of them, and ``moved`` the names on the real arm of the
    policy's joints, in the policy's order.
    """

    def __init__(self, joints: Contract) -> None:
        moved = joints["names"]
        real = joints.get("real")
        if not real:
            real = [{"joint": n, "name": n, "scale": 1.0, "offset": 0.0} for n in moved]
        column = {joint["joint"]: number for number, joint in enumerate(real)}
        self._columns = [column[name] for name in moved]
        self.joints = tuple(column)
        self.names = tuple(joint["name"] for joint in real)
        self.moved = tuple(self.names[number] for number in self._columns)
        limits = [joint.get("limits", ENDLESS) for joint in real]
        self._lower, self._upper = np.transpose(limits)
        self._offset = np.array([joint["offset"] for joint in real], float)
        scale = np.array([joint["scale"] for joint in real], float)
        self._scale = scale[self._columns]
        is_finite = np.isfinite([self._offset, scale]).all()
        is_named = len(set(self.names)) == len(real)
        if not (is_finite and is_named and self._scale.all()):
            raise ValueError(
                "joints.real has names twice, or numbers that are not finite or 0"
            )

    def to_real(self, angles: Any) -> ndarray:
        """Convert the policy's joint angles (..., J) [rad] to values of the real arm (..., R)."""
        values = np.tile(self._offset, (*np.shape(angles)[:-1], 1))
        values[..., self._columns] += self._scale * angles
        return values.clip(self._lower, self._upper)

    def from_real(self, values: Any) -> ndarray:
        """Convert values of the real arm (..., R) to the policy's joint angles (..., J) [rad]."""
        scaled = np.asarray(values, float) - self._offset
        return scaled[..., self._columns] / self._scale


class Lens:
    """Lens of a real camera, a contract's ``camera`` with intrinsics: rectifies its images.

    ``shape`` (H, W, 3) is that of an image of such a camera.
    """

    def __init__(self, camera: Contract) -> None:
        self._size = camera["size"]
        self._half = np.tan(np.radians(camera["fovy_deg"]) / 2)
        self._intrinsics = np.array(camera["intrinsics"], float)
        self._distortion = np.zeros(5)
        self._distortion[: len(camera["distortion"])] = camera["distortion"]
        height = 2 * self._size
        self.shape = (height, round(2 * height * self._intrinsics[2]), 3)
        self._rows_columns: dict[Any, tuple[ndarray, ndarray]] = {}

    def problem(self, images: ndarray) -> str:
        """Say why images are not whole ones of the camera, (n, H, W, 3) uint8; '' if they are."""
        if images.ndim == 4 and images.shape[3] == 3 and images.dtype == np.uint8:
            height, width = images.shape[1:3]
            middle = np.array([width, height]) / 2
            cut = np.abs(self._intrinsics[2:] * height - middle).max()
            if height > self._size and cut <= MOST_CROPPED * height:
                return ""
        return (
            f"images must be uint8 RGB and whole, such as {(1, *self.shape)}, as the contract has "
            f"the camera's lens: not cropped or shrunk; got {images.shape} {images.dtype}"
        )

    def rectified(self, images: ndarray) -> ndarray:
        """Return what the policy's camera sees of whole images (n, H, W, 3) uint8; black beside.

        Raises `ValueError` for other images.
        """
        problem = self.problem(images)
        if problem:
            raise ValueError(problem)
        count, height, width, _ = images.shape
        rows, columns = self._pixels(height, width)
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        fine = images[:, rows.clip(0, height - 1), columns.clip(0, width - 1)]
        fine = np.where(inside[:, :, None], fine, 0)
        blocks = (count, self._size, SAMPLES, self._size, SAMPLES, 3)
        coarse = fine.reshape(blocks).mean(axis=(2, 4))
        return coarse.round().astype(np.uint8)

    def _pixels(self, height: int, width: int) -> tuple[ndarray, ndarray]:
        """Return rows and columns of an image that each sample sees, after OpenCV's model."""
        if (height, width) not in self._rows_columns:
            samples = self._size * SAMPLES
            line = ((np.arange(samples) + 0.5) / samples * 2 - 1) * self._half
            x, y = np.meshgrid(line, line)
            k1, k2, p1, p2, k3 = self._distortion
            square = x * x + y * y
            radial = 1 + square * (k1 + square * (k2 + square * k3))
            bent_x = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)
            bent_y = y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y
            focal_x, focal_y, middle_x, middle_y = self._intrinsics * height
            rows = np.floor(focal_y * bent_y + middle_y).astype(int)
            columns = np.floor(focal_x * bent_x + middle_x).astype(int)
            self._rows_columns = {(height, width): (rows, columns)}
        return self._rows_columns[height, width]


class Runner:
    """Plays n episodes side by side, one on a robot, and then the next ones.

    Args:
        contract: the content of ``contract.json``.
        knowledge: (rows, width) float32, the content of ``knowledge.npy``.
        policy, recognition: the models; recognition is None for agents without such a network.

    Raises `ValueError` for a contract, table, input or output that is damaged or does not fit.
    ``targets`` are the joint angles that the actions have commanded, (n, J) [rad], and
    ``joint_map`` converts them to what the real arm is sent, and its readings to them. Policies
    that close fingers have these as one more joint, number ``fingers``, in metres of each finger.
    """

    def __init__(
        self,
        contract: Contract,
        knowledge: ndarray,
        policy: Model,
        recognition: Model | None = None,
    ) -> None:
        joints = contract["joints"]
        self.contract = contract
        self.joint_names = tuple(joints["names"])
        self.lower = np.array(joints["lower"], float)
        self.upper = np.array(joints["upper"], float)
        self.increments = np.array(joints["increments"], float)
        gripper = joints.get("gripper")
        self.fingers = None  # Number of the joint that closes the gripper
        self._closed_m = 1.0
        count = len(self.joint_names)
        self._resting = np.full(count, RESTING_RAD)
        if gripper:
            name = gripper["joint"]
            _require(name in self.joint_names, "the gripper is one of its joints")
            self.fingers = self.joint_names.index(name)
            self._closed_m = float(gripper["closed"])
            self._resting[self.fingers] = RESTING_M
        self._table = knowledge
        self._check_contract()
        self.joint_map = JointMap(joints)
        self.is_started = False
        self._policy = policy
        self._recognition = recognition
        size = contract["camera"]["size"]
        self.lens = None  # That of the real camera, whose images `act` rectifies
        self.image_shape = (size, size, 3)
        if "intrinsics" in contract["camera"]:
            self.lens = Lens(contract["camera"])
            self.image_shape = self.lens.shape

    def _check_contract(self) -> None:
        """Raise `ValueError` for a contract or table by which nothing should move."""
        contract = self.contract
        names = self.joint_names
        rows = contract["knowledge"]["rows"]
        mpi = contract["joints"]["mpi"]
        box = np.array([*contract["workspace_m"].values()], float)
        sizes = [
            contract["control_period_s"],
            contract["max_episode_steps"],
            mpi,
            self._closed_m,
            contract["camera"]["size"],
            contract["recurrent"]["size"],
        ]
        arrays = (self.lower, self.upper, self.increments, box, sizes, self._table)
        for numbers in arrays:
            _require(np.isfinite(numbers).all(), "numbers are finite")
        _require(min(sizes) > 0, "periods, steps and sizes are larger than 0")
        _require(len(set(names)) == len(names) > 0, "the names of the joints differ")
        is_complete = self.lower.shape == self.upper.shape == (len(names),)
        _require(is_complete, "every joint has a lower and an upper limit")
        is_ordered = (self.lower < self.upper).all() and box.shape == (2, 3)
        _require(is_ordered, "lower limits lie below upper ones")
        largest = np.abs(self.increments).max(initial=0)
        _require(largest <= mpi * (1 + 1e-6), "no action exceeds mpi")
        is_named = len(set(rows)) == len(rows) == len(self._table) > 0
        _require(is_named, "every row of the table has a name")

    @classmethod
    def load(cls, folder: str | Path) -> "Runner":
        """Load an exported folder: the files that the contract describes, and no others."""
        folder = Path(folder)
        file = folder / "contract.json"
        if not file.is_file():
            raise ValueError(f"{file} is no file; export again")
        contract = json.loads(file.read_text("utf-8"))
        if not isinstance(contract, dict) or contract.get("format") != FORMAT:
            raise ValueError(
                f"{folder} has no contract of the format {FORMAT}; export again"
            )
        files = ["policy.onnx", "knowledge.npy"]
        if contract["recognition"]:
            files.append("recognition.onnx")
        _check_files(folder, files, contract)
        recognition = None
        if contract["recognition"]:
            recognition = _load_model(folder, "recognition.onnx", contract)
        policy = _load_model(folder, "policy.onnx", contract)
        return cls(contract, np.load(folder / "knowledge.npy"), policy, recognition)

    def reset(self, batch: Any) -> None:
        """Start the episodes of a `Start`, or of anything with its members."""
        self.is_started = False
        missing = [name for name in self.joint_names if name not in batch.joints]
        if missing:
            raise ValueError(f"joints lack {', '.join(missing)}; got {[*batch.joints]}")
        columns = [batch.joints[name] for name in self.joint_names]
        angles = np.atleast_2d(np.transpose(columns))
        above = angles > self.lower - self._resting
        below = angles < self.upper + self._resting
        if not (above & below).all():
            raise ValueError(
                f"joint angles {angles.tolist()} are not finite and within the limits"
            )
        rows = self._knowledge_rows(batch, len(angles))
        self.targets = angles.clip(self.lower, self.upper)
        self._knowledge = self._table[rows]
        size = self.contract["recurrent"]["size"]
        self._h = np.zeros((len(angles), size), np.float32)
        self._c = self._h
        self._first = True
        self.is_started = True

    def _knowledge_rows(self, batch: Any, episodes: int) -> ndarray:
        """Return the row of the knowledge table for each episode."""
        rows = self.contract["knowledge"]["rows"]
        if len(rows) == 1:
            return np.zeros(episodes, int)
        names = np.atleast_1d(batch.names).tolist()
        for name in names:
            if name not in rows:
                raise ValueError(
                    f"knowledge must be a row such as {rows[0]!r}, got {name!r}"
                )
        if len(names) != episodes:
            raise ValueError(f"{episodes} episodes start, and {len(names)} have names")
        return np.array([rows.index(name) for name in names])

    def act(self, observations: Arrays) -> ndarray:
        """Return levels (n, J) for the images (n, H, W, 3) uint8, and add them to `targets`.

        Images have the contract's size; whole ones of a camera with a `lens` are rectified.
        """
        if not self.is_started:
            raise ValueError("no episode has started; give the joint angles first")
        image = observations["image"]
        if self.lens is not None:
            image = self.lens.rectified(image)
        size = self.contract["camera"]["size"]
        shape = (len(self.targets), size, size, 3)
        if image.shape != shape or image.dtype != np.uint8:
            raise ValueError(
                f"image must be {shape} uint8, got {image.shape} {image.dtype}"
            )
        if self._first and self._recognition is not None:
            # The network recognizes objects once, in the first image: later the arm hides some.
            inputs = {"image": image, "query": self._knowledge}
            (self._knowledge,) = self._recognition(inputs)
        inputs = {
            "image": image,
            "knowledge": self._knowledge,
            "h": self._h,
            "c": self._c,
            "episode_start": np.full(len(image), self._first),
        }
        levels, _, _, h, c = self._policy(inputs)
        self._check_outputs(np.asarray(levels), h, c)
        self._h = h
        self._c = c
        self._first = False
        targets = self.targets + self.increments[levels]
        self.targets = targets.clip(self.lower, self.upper)
        return levels

    def closed(self, targets: ndarray) -> ndarray:
        """Return how far joint targets (..., J) close the gripper, from 0 (open) to 1 (closed)."""
        if self.fingers is None:
            raise ValueError("this policy moves no gripper")
        share = targets[..., self.fingers] / self._closed_m
        return share.clip(0.0, 1.0)

    def _check_outputs(self, levels: ndarray, h: ndarray, c: ndarray) -> None:
        """Raise `ValueError` for outputs of the policy by which nothing should move."""
        if levels.shape != self.targets.shape or levels.dtype.kind not in "iu":
            raise ValueError(f"the policy gives levels {levels.shape} {levels.dtype}")
        last = len(self.increments) - 1
        if levels.min() < 0 or levels.max() > last or not np.isfinite([h, c]).all():
            raise ValueError(
                f"the policy gives levels beyond 0 to {last}, or no finite state"
            )


def _check_files(folder: Path, names: list[str], contract: Contract) -> None:
    """Raise `ValueError` unless a folder holds the exported files, unchanged."""
    digests = contract["digests"]
    if set(digests) != set(names):
        raise ValueError(
            f"{folder} must state digests of {', '.join(names)}; export again"
        )
    for name in names:
        file = folder / name
        data = file.read_bytes() if file.is_file() else b""
        if hashlib.sha256(data).hexdigest() != digests[name]:
            raise ValueError(f"{file} is not the exported file; export again")


def _load_model(folder: Path, name: str, contract: Contract) -> Model:
    """Load an ONNX model of an exported folder, which carries the fingerprint of its contract."""
    import onnxruntime

    session = onnxruntime.InferenceSession(folder / name)
    about = session.get_modelmeta().custom_metadata_map
    if about.get("contract") != fingerprint(contract):
        raise ValueError(
            f"{folder / 'contract.json'} is not that of {name}; export again"
        )
    names = [tensor.name for tensor in session.get_inputs()]

    def model(inputs: Arrays) -> Sequence[ndarray]:
        return list(session.run(None, {name: inputs[name] for name in names}))

    return model


def fingerprint(contract: Contract) -> str:
    """Return the digest of a contract that its models carry: of all but the digests of files."""
    stated = dict(contract)
    stated.pop("digests", None)
    text = json.dumps(stated, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _require(is_right: Any, what: str) -> None:
    if not is_right:
        raise ValueError(
            f"the contract is damaged: it must hold that {what}; export again"
        )
