"""Policies of other libraries: ONNX files and models of Stable-Baselines3."""

from pathlib import Path
from typing import Any

import numpy as np

from knowarm.arrays import Integers
from knowarm.deploy.runner import Runner
from knowarm.errors import UserError, packages_of
from knowarm.reading import digest, one_line, read_bytes, reading
from knowarm.world.agents.protocol import Batch, Observations
from knowarm.world.tasks.state import ACTION_LEVELS, nearest_levels


class OnnxPolicy:
    """Plays an ONNX file: observations and states in, levels (n, J) or scores (n, J, 7) out.

    Inputs that are no observation are recurrent states, float32, zeros as an episode starts; the
    outputs after the first are their next values, in the same order.
    """

    def __init__(self, path: Path) -> None:
        with packages_of("onnx", "An ONNX file"):
            import onnxruntime
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1  # sums in the same order on every machine
        with reading(path, "Give the ONNX file of a policy."):
            self._session = session = onnxruntime.InferenceSession(path, options)
        self._observed = set()
        self._state_sizes = {}
        for tensor in session.get_inputs():
            if tensor.name in ("image", "joint_targets"):
                self._observed.add(tensor.name)
            else:
                self._state_sizes[tensor.name] = tensor.shape[1:]
        if len(session.get_outputs()) != 1 + len(self._state_sizes):
            raise UserError(
                f"{path} must have an output for the actions and one per state (all inputs but "
                f"image and joint_targets; here {', '.join(self._state_sizes) or 'none'})."
            )
        self._path = path
        self.inputs = tuple(self._observed & {"image"})
        self.training = session.get_modelmeta().custom_metadata_map.get("training", "")
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
            actions, *states = self._session.run(None, inputs)
        except Exception as error:  # ONNX Runtime's errors have no common class
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

    def __init__(self, runner: Runner, folder: Path) -> None:
        self._runner = runner
        self._folder = folder

    def reset(self, batch: Batch) -> None:
        """Start the episodes."""
        with reading(self._folder, "Export the policy again."):
            self._runner.reset(batch)

    def act(self, observations: Observations) -> Integers:
        """Choose actions (n, J)."""
        with reading(self._folder, "Export the policy again."):
            return self._runner.act(observations)


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
