"""Perception module: names the visible objects and their colours in an image; its file format."""

import hashlib
import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import torch
from safetensors.torch import load, save
from torch import Tensor, nn

from knowarm.config import check_numbers, from_dict, to_dict
from knowarm.errors import UserError
from knowarm.policy.encoder import RELU_GAIN, orthogonal
from knowarm.reading import UnreadableFileError, one_line, reading
from knowarm.seeding import torch_generator
from knowarm.world.config import EnvConfig
from knowarm.world.scene import list_facets, scene_of

ABOUT = "knowarm"
"""Key of the file's metadata."""

AGAIN = "Restore the file, or make one with `knowarm perception train EXPERIMENT --out FILE`."
"""Remedy for a damaged file."""


@dataclass(frozen=True, kw_only=True)
class PerceptionConfig:
    """How a perception module is trained; its labels come from the simulator.

    Raises:
        UserError: a number out of its range.
    """

    images: int = 20_000
    """Training images: first images of episodes."""

    epochs: int = 12
    """Passes over the training images."""

    batch: int = 128
    """Images per gradient step."""

    learning_rate: float = 2e-3
    """Largest learning rate of Adam; it rises and falls once (one cycle)."""

    seed: int = 0
    """Seed of initial weights, images and their order."""

    test_images: int = 2_000
    """Images of each test, which training did not see."""

    held_out_colours: tuple[str, ...] = ()
    """Colours that training does not show, to test whether they are recognized (reaching only)."""

    def __post_init__(self) -> None:
        check_numbers(self)
        for name in ("images", "epochs", "batch", "test_images"):
            if getattr(self, name) < 1:
                raise UserError(f"{name} must be at least 1, got {getattr(self, name)}.")
        if not self.learning_rate > 0:
            raise UserError(f"learning_rate must be above 0, got {self.learning_rate}.")


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What a perception module was made for, and how well it names what it sees."""

    robot: str
    """Name of the robot."""

    image_size: int
    """Width and height of the images [px]."""

    objects: int
    """Number of visible objects."""

    facets: tuple[tuple[str, str], ...]
    """The (object, colour) pairs that it tells apart, F."""

    config: PerceptionConfig
    """How it was trained."""

    accuracy: dict[str, dict[str, float]] = field(default_factory=dict)
    """Shares of what was named rightly, by test."""

    @classmethod
    def of(cls, env: EnvConfig, config: PerceptionConfig) -> "Seen":
        """Return what a module for a task sees."""
        scene = scene_of(env)
        return cls(
            robot=scene.robot.name,
            image_size=env.image_size,
            objects=visible_objects(env),
            facets=list_facets(scene, env.colours),
            config=config,
        )


def visible_objects(env: EnvConfig) -> int:
    """Return the number of objects in an image of a task."""
    return 1 if env.choice is None else env.choice.objects


class Perception(nn.Module):
    """Four convolutions that score objects and colours at every position of the image.

    A facet's score is the logarithm of the sum over positions of exp(object + colour), so that
    object and colour are found at one place.

    Args:
        seen: what it tells apart.
        seed: of the initial weights.

    Attributes:
        seen: as given.
    """

    FORMAT: ClassVar[str] = "knowarm-perception-1"
    """Format of the file."""

    CONVOLUTIONS: ClassVar = ((3, 16, 5, 2), (16, 32, 3, 2), (32, 64, 3, 2), (64, 64, 3, 1))
    """Inputs, outputs, kernel and stride of each convolution."""

    def __init__(self, seen: Seen, *, seed: int = 0) -> None:
        super().__init__()
        self.seen = seen
        objects = list(dict.fromkeys(name for name, _ in seen.facets))
        colours = list(dict.fromkeys(colour for _, colour in seen.facets))
        self._object = torch.tensor([objects.index(name) for name, _ in seen.facets])
        self._colour = torch.tensor([colours.index(colour) for _, colour in seen.facets])
        self.layers = nn.ModuleList(
            nn.Conv2d(inputs, outputs, kernel, stride, padding=kernel // 2)
            for inputs, outputs, kernel, stride in self.CONVOLUTIONS
        )
        self.objects = nn.Conv2d(self.CONVOLUTIONS[-1][1], len(objects), 1)
        self.colours = nn.Conv2d(self.CONVOLUTIONS[-1][1], len(colours), 1)
        if not self.objects.weight.is_meta:
            generator = torch_generator(seed, "perception")
            for layer in self.layers:
                orthogonal(layer, RELU_GAIN, generator)
            for layer in (self.objects, self.colours):
                orthogonal(layer, 1.0, generator)

    def forward(self, images: Tensor) -> Tensor:
        """Score the facets in images (n, H, W, 3) uint8: (n, F) float32, softmax over facets."""
        return self.names(self.features(images))

    def features(self, images: Tensor) -> Tensor:
        """Compute the features of images (n, H, W, 3) uint8, by place: (n, C, h, w) float32."""
        x = images.permute(0, 3, 1, 2).float() / 255 - 0.5
        for layer in self.layers:
            x = torch.relu(layer(x))
        return x

    def names(self, features: Tensor) -> Tensor:
        """Score the facets by `features`: (n, F) float32."""
        objects, colours = self.objects(features).flatten(2), self.colours(features).flatten(2)
        # The sum over places of exp(object + colour) of all pairs is a product of two matrices.
        most = [scores.amax((1, 2), keepdim=True) for scores in (objects, colours)]
        sums = (objects - most[0]).exp() @ (colours - most[1]).exp().transpose(1, 2)
        scores = sums.clamp(min=torch.finfo(sums.dtype).tiny).log() + most[0] + most[1]
        return scores[:, self._object, self._colour]

    def named(self, images: Tensor) -> Tensor:
        """Return the facets named in images, the surest first: (n, visible objects) int64."""
        return self(images).topk(min(self.seen.objects, len(self.seen.facets)), dim=1).indices

    def _apply(self, function: Any, recurse: bool = True) -> "Perception":
        super()._apply(function, recurse)
        self._object, self._colour = function(self._object), function(self._colour)
        return self

    def describe(self) -> dict[str, Any]:
        """Return what the file says beside the parameters."""
        return {"format": self.FORMAT, "seen": to_dict(self.seen)}

    def to_bytes(self) -> bytes:
        """Return the content of the module's file."""
        tensors = {name: value.contiguous().cpu() for name, value in self.state_dict().items()}
        # One entry: safetensors writes several in an order that varies.
        return save(tensors, {ABOUT: json.dumps(self.describe())})

    @classmethod
    def build(cls, about: dict[str, Any], tensors: Mapping[str, Tensor]) -> "Perception":
        """Build a module from what its file says; the parameters are loaded afterwards.

        Args:
            about: the result of `describe`.
            tensors: the parameters.

        Raises:
            ValueError: what it says makes no module.
        """
        return cls(seen_of(about))


def digest(data: bytes) -> str:
    """Return the SHA-256 of a file's content, hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def write_perception(perception: Perception, path: Path) -> None:
    """Write a perception module.

    Raises:
        UserError: the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(perception.to_bytes())
    except OSError as error:
        raise UserError(f"Cannot write {path}: {error.strerror}. Give another path.") from error


def read_perception(path: Path) -> Perception:
    """Read a perception module.

    Raises:
        UnreadableFileError: the file is missing, damaged, or of another format.
    """
    return perception_of(read_module(path), path)


def read_module(path: Path) -> bytes:
    """Read the content of a perception module's file.

    Raises:
        UnreadableFileError: the file cannot be read.
    """
    with reading(path, AGAIN):
        return path.read_bytes()


def perception_of(
    data: bytes, path: Path, kinds: Sequence[type[Perception]] = (Perception,)
) -> Perception:
    """Build a perception module from the content of its file.

    Args:
        data: the content.
        path: the file, for messages.
        kinds: classes that the file may hold.

    Raises:
        UnreadableFileError: the content is damaged or of another format.
    """
    with reading(path, AGAIN):
        tensors = load(data)
        (length,) = struct.unpack_from("<Q", data)
        metadata = json.loads(data[8 : 8 + length]).get("__metadata__") or {}
        about = json.loads(metadata.get(ABOUT, "{}"))
        kind = next((each for each in kinds if about.get("format") == each.FORMAT), None)
        if kind is None:
            expects = " or ".join(repr(each.FORMAT) for each in kinds)
            raise UnreadableFileError(
                f"{path} holds no perception module (format {about.get('format')!r}, expected "
                f"{expects}). {AGAIN}"
            )
        with torch.device("meta"):  # sizes are compared before memory is allocated
            module = kind.build(about, tensors)
            expected = {n: tuple(v.shape) for n, v in module.state_dict().items()}
        if {name: tuple(value.shape) for name, value in tensors.items()} != expected:
            raise ValueError("its arrays do not fit the facets that it names")
        if not all(v.is_floating_point() and v.isfinite().all() for v in tensors.values()):
            raise ValueError("it contains non-finite values")
        perception = kind.build(about, tensors)
        perception.load_state_dict(tensors)
    return perception.eval().requires_grad_(False)


def seen_of(about: dict[str, Any]) -> Seen:
    """Read from the `Perception.describe` of a file what a module was made for.

    Raises:
        ValueError: it cannot be.
    """
    try:
        seen = from_dict(Seen, about["seen"])
    except UserError as error:
        raise ValueError(one_line(error)) from error
    if not seen.facets or len(set(seen.facets)) != len(seen.facets):
        raise ValueError("it names no facets, or one twice")
    return seen


def check_fits(seen: Seen, env: EnvConfig, facets: Sequence[tuple[str, str]]) -> None:
    """Check that a module can name what a task shows.

    Args:
        seen: what the module was made for.
        env: the task.
        facets: the task's (object, colour) pairs.

    Raises:
        UserError: it was made for another robot, image size, number of objects, or other objects.
    """
    for what, made, needed in (
        ("the robot", seen.robot, scene_of(env).robot.name),
        ("an image size of", seen.image_size, env.image_size),
        ("a number of visible objects of", seen.objects, visible_objects(env)),
    ):
        if made != needed:
            raise UserError(
                f"The perception module was made for {what} {made}, and this task has {needed}. "
                "Make one for this task with `knowarm perception train EXPERIMENT --out FILE`."
            )
    unknown = [" ".join(reversed(facet)) for facet in facets if facet not in seen.facets]
    if unknown:
        raise UserError(
            f"The perception module does not know {', '.join(unknown[:5])}, which this task shows. "
            "Make one for this task with `knowarm perception train EXPERIMENT --out FILE`."
        )
