"""Grounding network: finds in an image the object that a query means, and how to grasp it.

Each place of the image has a key; the object stands where the key is most similar to the vector of
the query. From the features of that place the network predicts the object's grasp frame. Where
objects have parts, each place has a key and a frame per part: a cell is a place and a part.
"""

import json
from collections.abc import Callable
from itertools import pairwise, starmap
from math import ceil
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
import torch
from safetensors.torch import load, save
from torch import Tensor, nn
from torch.nn.functional import pad

from knowarm.config import from_dict, to_dict
from knowarm.errors import UserError
from knowarm.perception.config import FRAME, GroundingSpec
from knowarm.perception.encoder import PlaceEncoder
from knowarm.perception.images import LabelledImages, QueryAnswers
from knowarm.policy.encoder import RELU_GAIN, orthogonal
from knowarm.questions import number_parts
from knowarm.reading import UnreadableFileError, one_line, reading, replacing
from knowarm.seeding import torch_generator

STRIDE = 4
"""Distance of two places in the image [px]."""
WIDTH = 64
"""Dimensions in which places and queries are compared, D."""

FORMAT = "knowarm-grounding-2"
"""Format of the file."""
METADATA = "knowarm"
"""Key of the file's metadata."""
ENCODER = "encoder."
"""Beginning of names of parameters, which the file leaves out."""
REMEDY = "Restore the file, or take perception.safetensors of another run."
BATCH = 256
"""Most images that are processed at once."""

DEEP_HEAD_GAIN = 0.6
"""Gain of the initial weights of the frame head for neighbourhoods; with a gain for ReLU it learned
more slowly."""


class GroundingNetwork(nn.Module):
    """Network that compares the places of an image with a query and predicts grasp frames.

    Args:
        spec: what the images show.
        knowledge: (Q, K) float32, one row per query.
        slots: number of equal parts of a row, one per condition; a part of zeros is none.
        seed: of the initial weights.
        first_stage: with the frame head of the first stage of a training, which predicts frames
            from the object's place alone; the final one reads the 3 x 3 places around it.
    """

    knowledge: Tensor
    """(Q, K) buffer, the table of the training."""
    position_mean: Tensor
    position_std: Tensor
    """(3,) buffers, of the grasp positions in training [m]."""
    part_of: Tensor
    """(F,) int64 buffer: number of each facet among the parts of its object."""

    def __init__(
        self,
        spec: GroundingSpec,
        knowledge: np.ndarray | Tensor,
        slots: int,
        *,
        seed: int = 0,
        first_stage: bool = False,
    ) -> None:
        super().__init__()
        self.spec = spec
        self.slots = slots
        channels = spec.config.channels
        self.encoder = PlaceEncoder(spec.facets, channels, seed)
        self.register_buffer(
            "knowledge", torch.as_tensor(knowledge, dtype=torch.float32).clone()
        )
        self.register_buffer("position_mean", torch.zeros(3))
        self.register_buffer("position_std", torch.ones(3))
        parts_of_object = number_parts(spec.facets)  # of the object of each facet
        self.parts = parts_of_object.shape[1]
        facet = np.arange(len(parts_of_object))[:, None]
        part_of = torch.from_numpy((parts_of_object == facet).argmax(1))
        self.register_buffer("part_of", part_of, persistent=False)
        generator = torch_generator(seed, "perception", 1)
        keys = [channels, 2 * WIDTH, WIDTH * self.parts]
        self.key = _layers(keys, RELU_GAIN, generator)
        queries = [self.knowledge.shape[1] // slots, 2 * WIDTH, WIDTH]
        self.query = _layers(queries, RELU_GAIN, generator)
        frames = FRAME * self.parts
        if first_stage:
            self._side = 1
            self.frame = _layers(
                [channels + 2, 2 * WIDTH, frames], RELU_GAIN, generator
            )
        else:
            self._side = 3
            widths = [9 * channels + 2, 4 * WIDTH, 4 * WIDTH, frames]
            self.frame = _layers(widths, DEEP_HEAD_GAIN, generator)
            # Features differ in scale, and many are zero.
            self.frame.insert(0, Standardize(widths[0]))

    def to_bytes(self) -> bytes:
        """Return the content of the network's file."""
        tensors = {}
        for name, value in self.state_dict().items():
            tensors[name.removeprefix(ENCODER)] = value.contiguous().cpu()
        about = {"format": FORMAT, "seen": to_dict(self.spec), "slots": self.slots}
        # One entry: safetensors writes several in an order that varies.
        return save(tensors, {METADATA: json.dumps(about)})

    def write(self, path: Path) -> None:
        """Write the network to a file."""
        with replacing(path) as temporary:
            temporary.write_bytes(self.to_bytes())

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a network from a file."""
        with reading(path, REMEDY):
            return cls.from_bytes(path.read_bytes(), path)

    @classmethod
    def from_bytes(cls, data: bytes, path: Path = Path("network")) -> Self:
        """Build a network from the content of its file; the path is for messages."""
        with reading(path, REMEDY):
            tensors = load(data)
            about = _metadata(data)
            if about.get("format") != FORMAT:
                raise UnreadableFileError(
                    f"{path} holds no grounding network (format {about.get('format')!r}, expected "
                    f"{FORMAT!r}). {REMEDY}"
                )
            try:
                spec = from_dict(GroundingSpec, about["seen"])
            except UserError as error:
                raise ValueError(one_line(error)) from error
            if not spec.facets or len(set(spec.facets)) != len(spec.facets):
                raise ValueError("it names no facets, or one twice")
            table = tensors["knowledge"]
            slots = about["slots"]
            is_number = isinstance(slots, int) and slots > 0
            if not is_number or table.ndim != 2 or table.shape[1] % slots:
                raise ValueError("its table of knowledge does not fit its slots")
            network = cls(spec, table, slots)
            state = {}
            shapes = {}
            for name, value in network.state_dict().items():
                stored = name.removeprefix(ENCODER)
                shapes[stored] = value.shape
                state[name] = tensors.get(stored)
            if shapes != {name: value.shape for name, value in tensors.items()}:
                raise ValueError("its arrays do not fit the facets that it names")
            for value in tensors.values():
                if not value.is_floating_point() or not value.isfinite().all():
                    raise ValueError("it contains non-finite values")
            network.load_state_dict(state)
        return network.eval().requires_grad_(False)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy, and send to other processes, by the content of the file."""
        return type(self).from_bytes, (self.to_bytes(),)

    def keys(self, features: Tensor) -> Tensor:
        """Compute the keys of the cells from the encoder's features: (n, P parts, D)."""
        keys = self.key(features.flatten(2).transpose(1, 2))  # (n, places, P D)
        return cast(Tensor, keys.unflatten(2, (self.parts, WIDTH)).flatten(1, 2))

    def cells(self, places: Tensor, facets: Tensor) -> Tensor:
        """Return the cells of facets (...) int64 at places (...) int64."""
        return places * self.parts + self.part_of[facets]

    def project_queries(self, knowledge: Tensor) -> Tensor:
        """Project the knowledge of queries (Q, K) into the space of the keys: (Q, D)."""
        slots = knowledge.unflatten(1, (self.slots, -1))
        used = (slots != 0).any(2, keepdim=True)  # a slot of zeros is no condition
        # Of a query without conditions, the first slot counts.
        used[:, 0] |= ~used.any(1)
        return (self.query(slots) * used).sum(1) / WIDTH**0.5

    def frames(self, features: Tensor, cells: Tensor) -> Tensor:
        """Predict the grasp frames of the objects or parts in cells (n, m) int64, row by row.

        Returns:
            (n, m, 9) float32: standardized position, x and z axis.
        """
        inputs = self.frame_inputs(features, cells // self.parts)
        return self.frames_of(inputs, cells % self.parts)

    def frames_of(self, inputs: Tensor, part: Tensor) -> Tensor:
        """Predict frames (..., 9) of the parts (...) int64 from `frame_inputs` (..., D)."""
        frames = self.frame(inputs).unflatten(-1, (-1, FRAME))  # of all parts
        # `take_along_dim` would fix the batch size of an ONNX export.
        index = part[..., None, None].expand(*part.shape, 1, FRAME)
        return cast(Tensor, frames.gather(-2, index).squeeze(-2))

    def frame_inputs(self, features: Tensor, places: Tensor) -> Tensor:
        """Return what frames at places (n, m) are predicted from: features, and where they are.

        The inputs (n, m, D) start with the features of 3 x 3 places; in the first stage of one.
        """
        around = self._side // 2
        padded = pad(features, (around,) * 4)
        # A view of the places around every place: (n, C, h, w, side, side).
        windows = padded.unfold(2, self._side, 1).unfold(3, self._side, 1)
        image = torch.arange(places.shape[0], device=places.device)[:, None]
        row = places // features.shape[3]
        column = places % features.shape[3]
        inputs = windows[image, :, row, column].flatten(2)
        half = self.spec.image_size / 2
        where = centres(self.spec.image_size).to(inputs) / half - 1
        return torch.cat((inputs, where[places]), 2)

    def standardized(self, position: Tensor, axes: Tensor) -> Tensor:
        """Return the numbers of grasp frames (..., 9) with positions (..., 3) and axes (..., 6)."""
        return torch.cat(
            ((position - self.position_mean) / self.position_std, axes), -1
        )

    def forward(self, images: Tensor, knowledge: Tensor) -> Tensor:
        """Predict the grasp frames (n, 9) of what queries with knowledge (n, K) mean."""
        features = self.encoder.features(images)
        cell = self.cell_scores(features, knowledge).argmax(1)
        return self.frames(features, cell[:, None])[:, 0]

    def cell_scores(self, features: Tensor, knowledge: Tensor) -> Tensor:
        """Compare the keys of the cells with the knowledge of queries (n, K): (n, cells)."""
        queries = self.project_queries(knowledge)
        return (self.keys(features) * queries[:, None]).sum(2)

    def features(self, images: Tensor, bfloat16: bool = False) -> Tensor:
        """Compute the encoder's features, with its convolutions in bfloat16 if asked for."""
        with torch.autocast("cpu", torch.bfloat16, enabled=bfloat16):
            return self.encoder.features(images)

    def place_loss(
        self,
        features: Tensor,
        labels: LabelledImages,
        knowledge: Tensor,
        answers: QueryAnswers,
        *,
        bfloat16: bool = False,
    ) -> Tensor:
        """Compute the cross-entropy of the places of the objects that queries mean.

        An image counts for the queries that the task may have for one of its objects and that mean
        no other one.

        Args:
            features: of n images.
            labels: of these images.
            knowledge: (q, K) float32, of the queries.
            answers: to these queries, among the facets of the network.
            bfloat16: for the keys.
        """
        facets = labels.facets
        places = place_of(labels.pixels, self.spec.image_size)
        with torch.autocast("cpu", torch.bfloat16, enabled=bfloat16):
            keys = self.keys(features)
        scores = keys.float() @ self.project_queries(knowledge).T  # (n, cells, q)
        satisfies = answers.satisfies[:, facets].transpose(0, 1)  # (n, q, m)
        askable = answers.askable[:, facets].transpose(0, 1)
        asked = (satisfies.sum(2) == 1) & (satisfies & askable).any(2)
        if answers.marked:  # the image answers for the marked object only
            asked &= satisfies[..., 0]
        cells = self.cells(places, facets)
        cell = cells.gather(1, satisfies.float().argmax(2))
        likelihood = scores.log_softmax(1).gather(1, cell[:, None])[:, 0]
        return -(likelihood * asked).sum() / asked.sum().clamp(min=1)

    def recognition_losses(
        self, features: Tensor, labels: LabelledImages
    ) -> tuple[Tensor, Tensor]:
        """Compute the cross-entropy of the visible names and the squared error of their frames."""
        facets = labels.facets
        places = place_of(labels.pixels, self.spec.image_size)
        likelihood = self.encoder.facet_likelihood(features, facets, places)
        truth = self.standardized(labels.grasp_position, labels.grasp_axes)
        frames = self.frames(features, self.cells(places, facets))
        return -likelihood.mean(), (frames - truth).square().mean()


class Standardize(nn.Module):
    """Standardizes features (..., D) by the mean and deviation of others."""

    mean: Tensor
    deviation: Tensor
    """(D,) buffers."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(features))
        self.register_buffer("deviation", torch.ones(features))

    def fit(self, values: Tensor) -> None:
        """Take mean and deviation of values (N, D); features that are always zero stay so."""
        self.mean.copy_(values.mean(0))
        self.deviation.copy_(values.std(0).clamp(min=1e-3))

    def forward(self, values: Tensor) -> Tensor:
        """Standardize values (..., D)."""
        return (values - self.mean) / self.deviation


def in_batches(compute: Callable[..., Tensor], *tensors: Tensor) -> Tensor:
    """Compute something of at most `BATCH` rows of tensors at once; return all of it."""
    batches = zip(*[tensor.split(BATCH) for tensor in tensors], strict=True)
    return torch.cat(list(starmap(compute, batches)))


def _metadata(data: bytes) -> dict[str, Any]:
    """Return what a file of safetensors says about itself."""
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    metadata = header.get("__metadata__") or {}
    about: dict[str, Any] = json.loads(metadata.get(METADATA, "{}"))
    return about


def _layers(
    widths: list[int], gain: float, generator: torch.Generator
) -> nn.Sequential:
    """Return linear layers of these widths, initialized, with ReLU between them."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(widths):
        linear = nn.Linear(inputs, outputs)
        orthogonal(linear, gain, generator)
        layers += [linear, nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def place_of(pixel: Tensor, image_size: int) -> Tensor:
    """Return the place (...) int64 of image points (..., 2), column and row [px]."""
    side = ceil(image_size / STRIDE)
    place = (pixel / STRIDE).long().clamp(0, side - 1)
    column, row = place.unbind(-1)
    return row * side + column


def centres(image_size: int) -> Tensor:
    """Return column and row of the centre of every place, (P, 2) float32 [px]."""
    side = ceil(image_size / STRIDE)
    line = (torch.arange(side) + 0.5) * STRIDE
    row, column = torch.meshgrid(line, line, indexing="ij")
    return torch.stack((column.flatten(), row.flatten()), dim=1)
