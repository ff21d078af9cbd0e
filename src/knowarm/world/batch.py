"""Batches of simulations: ``mujoco.batch``, or what is used of it here over ``mj_step``."""

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from itertools import repeat
from operator import attrgetter
from typing import Any

import numpy as np
from mujoco import (
    MjData,
    MjModel,
    mj_forward,
    mj_fwdPosition,
    mj_getState,
    mj_setState,
    mj_stateSize,
    mj_step,
    mj_versionString,
    mjtStage,
    mjtState,
)

from knowarm.arrays import Floats, Integers

MUJOCO = tuple(map(int, mj_versionString().split(".")[:2]))
"""Version of MuJoCo."""

_INTEGRATION = int(mjtState.mjSTATE_INTEGRATION)
"""Everything that determines the following steps."""

_STATES = {
    "time": mjtState.mjSTATE_TIME,
    "qpos": mjtState.mjSTATE_QPOS,
    "qvel": mjtState.mjSTATE_QVEL,
    "ctrl": mjtState.mjSTATE_CTRL,
    "qacc_warmstart": mjtState.mjSTATE_WARMSTART,
    "mocap_pos": mjtState.mjSTATE_MOCAP_POS,
    "mocap_quat": mjtState.mjSTATE_MOCAP_QUAT,
}
"""Fields of ``MjData`` that can be written, by their part of the state."""

_NONE = int(mjtStage.mjSTAGE_NONE)
_ALL = int(mjtStage.mjSTAGE_ACC)
_FORWARD = {
    _NONE: lambda model, data: None,
    int(mjtStage.mjSTAGE_POS): mj_fwdPosition,
    _ALL: mj_forward,
}
"""Computes the stages of ``mj_forward`` up to one."""


class LoopBatch:
    """n simulations of a model by ``mj_step``, shared by threads, as ``mujoco.batch.Batch``.

    Both give the same bytes; this one needs 1.1 to 1.2 times the CPU time, and runs on MuJoCo
    before 3.17. Each thread loads the state of one simulation after the other into one ``MjData``.

    Args:
        model: of all simulations.
        nsim: n.
        nthread: number of threads.

    Attributes:
        state: state of each simulation, (n, S), to read and write.
    """

    def __init__(self, model: MjModel, nsim: int, nthread: int) -> None:
        self.model = model
        self.nsim = nsim
        self._models = [copy(model) for _ in range(min(nthread, nsim))]
        self._data = [MjData(model) for model in self._models]
        self._pool = ThreadPoolExecutor(len(self._models))
        self._outputs: dict[str, Any] = {}
        self._fields: dict[str, Any] = {}
        start = np.zeros(mj_stateSize(model, _INTEGRATION))
        mj_getState(model, self._data[0], start, _INTEGRATION)
        self.state: Floats = np.tile(start, (nsim, 1))

    def bind(self, name: str) -> Any:
        """Return a field of ``MjData``, (n, ...): a view of the state, or renewed by each call."""
        template = np.asarray(getattr(self._data[0], name))
        if name in _STATES:
            part = int(_STATES[name])
            first = mj_stateSize(self.model, _INTEGRATION & (part - 1))
            rows = self.state[:, first : first + template.size]
            return rows.reshape(self.nsim, *template.shape)
        if name not in self._outputs:
            shape = (self.nsim, *template.shape)
            self._outputs[name] = np.zeros(shape, template.dtype)
        return self._outputs[name]

    def expand(self, name: str) -> Any:
        """Give a field of the model its own value in each simulation, (n, ...), to write."""
        if name not in self._fields:
            value = np.asarray(attrgetter(name)(self.model))
            self._fields[name] = np.repeat(value[None], self.nsim, axis=0)
        return self._fields[name]

    def forward(self, ids: Integers | None = None, stage: int = _ALL) -> None:
        """Compute the stages of ``mj_forward`` up to one, in some simulations or in all."""
        self.step(ids, 0, stage)

    def step(
        self, ids: Integers | None = None, nstep: int = 1, stage: int = _NONE
    ) -> None:
        """Advance some simulations, or all, and then compute stages as `forward`."""
        if ids is None:
            ids = np.arange(self.nsim)
        shares = np.array_split(ids, len(self._models))
        threads = range(len(shares))
        calls = (threads, shares, repeat(nstep), repeat(int(stage)))
        if len(ids) < 2 * len(shares):
            self._run(0, ids, nstep, int(stage))
        else:
            list(self._pool.map(self._run, *calls))

    def _run(self, thread: int, ids: Iterable[int], nstep: int, stage: int) -> None:
        """Advance simulations, one after the other, with the data of a thread."""
        model = self._models[thread]
        data = self._data[thread]
        for i in ids:
            for name, values in self._fields.items():
                _set_field(model, name, values[i])
            mj_setState(model, data, self.state[i], _INTEGRATION)
            if nstep:
                mj_step(model, data, nstep)
            _FORWARD[stage](model, data)
            mj_getState(model, data, self.state[i], _INTEGRATION)
            for name, output in self._outputs.items():
                output[i] = getattr(data, name)


def _set_field(model: MjModel, name: str, value: Any) -> None:
    """Set a field of a model, or of its options as "opt.timestep"."""
    if name.startswith("opt."):
        setattr(model.opt, name.removeprefix("opt."), value)
    else:
        getattr(model, name)[:] = value


make_batch: Any = LoopBatch
"""Make n simulations of a model on some threads: by ``mujoco.batch`` from MuJoCo 3.17 on."""

# Not by trial: beside an older MuJoCo, files of 4.0 may be left, which it cannot read.
if MUJOCO >= (3, 17):
    import mujoco.batch as native

    make_batch = native.Batch
