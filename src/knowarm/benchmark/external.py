"""Policies of other libraries: ONNX files and models of Stable-Baselines3."""

from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from knowarm.arrays import Integers
from knowarm.deploy.runner import Runner
from knowarm.errors import UserError, packages_of
from knowarm.fence import Fence
from knowarm.reading import digest, one_line, read_bytes, reading
from knowarm.world.agents.protocol import Batch, Observations
from knowarm.world.tasks.state import ACTION_LEVELS, nearest_levels

REMEDY = "Give the ONNX file of a policy."


class _Model:
    """A model of an ONNX file, loaded at the first call."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._session: Any = None

    def __call__(self, inputs: Observations | None = None) -> Any:
        """Return the outputs, or the inputs by size, the number of outputs and the training."""
        if self._session is None:
            import onnxruntime

            options = onnxruntime.SessionOptions()
            options.intra_op_num_threads = 1  # sums in the same order on every machine
            with reading(self._path, REMEDY):
                self._session = onnxruntime.InferenceSession(self._path, options)
        if inputs is not None:
            return self._session.run(None, inputs)
        sizes = {tensor.name: tensor.shape for tensor in self._session.get_inputs()}
        about = self._session.get_modelmeta().custom_metadata_map
        outputs = len(self._session.get_outputs())
        return sizes, outputs, about.get("training", "")


class OnnxPolicy:
    """Plays an ONNX file: observations and states in, levels (n, J) or scores (n, J, 7) out.

    Inputs that are no observation are recurrent states, float32, zeros as an episode starts; the
    outputs after the first are their next values, in the same order.
    """

    def __init__(self, path: Path) -> None:
        with packages_of("onnx", "An ONNX file"):
            import onnxruntime  # noqa: F401
        self._model = Fence(_Model(path))
        with reading(path, REMEDY):
            sizes, outputs, self.training = self._model()
        self._observed = sizes.keys() & {"image", "joint_targets"}
        self._state_sizes = {
            name: size[1:] for name, size in sizes.items() if name not in self._observed
        }
        if outputs != 1 + len(self._state_sizes):
            raise UserError(
                f"{path} must have an output for the actions and one per state (all inputs but "
                f"image and joint_targets; here {', '.join(self._state_sizes) or 'none'})."
            )
        self._path = path
        self.inputs = tuple(self._observed & {"image"})
        self.digest = digest(read_bytes(path))

    def reset(self, batch: Batch) -> None:
        """Start with states of zeros."""
        remedy = f"All sizes of states but the first are numbers: {self._state_sizes}."
        self._state = {}
        with reading(self._path, remedy):
            for name, size in self._state_sizes.items():
                self._state[name] = np.zeros((batch.size, *size), np.float32)

    def act(self, observations: Observations) -> Integers:
        """Run the model."""
        inputs = {name: observations[name] for name in self._observed}
        inputs |= self._state
        try:
            actions, *states = self._model(inputs)
        except ValueError as error:
            shapes = ", ".join(f"{k} {v.dtype} {v.shape}" for k, v in inputs.items())
            raise UserError(
                f"{self._path} does not take {shapes}: {one_line(error)}."
            ) from None
        self._state = dict(zip(self._state, states, strict=True))
        if actions.ndim != 3:
            return actions
        levels = len(ACTION_LEVELS)
        is_finite = np.isfinite(actions).all()
        if actions.shape[2] != levels or not is_finite:
            others = "" if is_finite else " with others"
            raise UserError(
                f"{self._path}: scores must be finite, (n, J, {levels}), got "
                f"{actions.shape}{others}."
            )
        return actions.argmax(-1)


class ExportedPolicy:
    """Plays the runner of an exported folder; what fails is an error of the folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._call = Fence(self._run)
        rows, self.joint_names = self._ask("about")
        self.rows = tuple(rows)

    def reset(self, batch: Batch) -> None:
        """Start the episodes."""
        self._ask("reset", replace(batch, graph=None))

    def act(self, observations: Observations) -> Integers:
        """Choose actions (n, J)."""
        return self._ask("act", observations)

    def _ask(self, *request: Any) -> Any:
        with reading(self._folder, "Export the policy again."):
            return self._call(*request)

    @cached_property
    def _runner(self) -> Runner:
        return Runner.load(self._folder)

    def _run(self, method: str, *arguments: Any) -> Any:
        """Call a method of the runner, which the fence alone loads."""
        if method == "about":
            rows = self._runner.contract["knowledge"]["rows"]
            return rows, self._runner.joint_names
        return getattr(self._runner, method)(*arguments)


class PredictingPolicy:
    """Plays a model with ``predict``, as those of Stable-Baselines3, greedily.

    It observes the image or a ``Dict`` of observations. Continuous actions are increments in units
    of the MPI and are played as the nearest levels.
    """

    def __init__(self, model: Any) -> None:
        self._model = model
        self._names = getattr(model.observation_space, "spaces", ("image",))
        if unknown := set(self._names) - {"image", "joint_targets"}:
            raise UserError(
                f"The {type(model).__name__} observes {', '.join(sorted(unknown))}; the benchmark "
                "gives image and joint_targets. Play its run folder, or write a policy of your own."
            )
        self.inputs = ("image",) if "image" in self._names else ()
        self.training = f"{type(model).__name__}, {model.num_timesteps:,} steps"
        self.seed = model.seed

    def reset(self, batch: Batch) -> None:
        """Forget the recurrent state."""
        self._state = None
        self._start = np.ones(batch.size, np.bool_)

    def act(self, observations: Observations) -> Integers:
        """Predict."""
        inputs: Any = observations["image"]
        if isinstance(self._names, dict):
            inputs = {name: observations[name] for name in self._names}
        actions, self._state = self._model.predict(
            inputs, self._state, self._start, True
        )
        self._start = np.zeros_like(self._start)
        if np.issubdtype(actions.dtype, np.integer):
            return actions
        return nearest_levels(actions)
