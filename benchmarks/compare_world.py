"""Comparison of simulation with images: KnowArm, Gymnasium with OpenGL, MuJoCo Warp's ray caster.

    pip install 'knowarm[bench]'
    python -m benchmarks.compare_world --json runs/bench/compare-world.json

All are measured in one run, with the same number of threads or processes each.
"""

import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any

import gymnasium
import mujoco
import numpy as np
import tyro
from gymnasium.vector import AsyncVectorEnv, AutoresetMode
from numpy.typing import NDArray

from benchmarks.speed import Speed, measure_steps
from benchmarks.world import WorldBenchConfig, bench_world, env_configs
from knowarm.cli.tables import check_output, print_table, write_json_table
from knowarm.errors import UserError
from knowarm.world import env_id
from knowarm.world.config import EnvConfig
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.scene.scene import Scene

FAR_BELOW_M = -100.0
"""Height at which hidden geoms are placed [m]: MuJoCo Warp ignores the alpha of a geom."""


@dataclass(frozen=True, kw_only=True)
class CompareWorldConfig(WorldBenchConfig):
    """Settings of the comparison."""

    scaling: bool = False
    """Also measure KnowArm with 1 to 4,096 environments and 32 to 256 pixels."""

    opengl: bool = True
    """Measure Gymnasium's AsyncVectorEnv with MuJoCo's OpenGL renderer (needs EGL or OSMesa)."""

    mjwarp: bool = True
    """Measure MuJoCo Warp's ray caster (needs the packages mujoco-warp and warp-lang)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mjwarp and self.num_envs % self.workers:
            raise UserError(
                f"num_envs ({self.num_envs}) must be a multiple of workers ({self.workers})."
            )


def compare_world(config: CompareWorldConfig) -> dict[str, Any]:
    """Measure environment steps per second of all libraries.

    Returns:
        The result of ``bench_world``, with the speeds of the other libraries and KnowArm's speed
        over theirs added to its rows: ``opengl_steps_per_s``, ``ratio_vs_opengl``,
        ``cpu_ratio_vs_opengl`` (by CPU time, which other programs disturb less), and the same for
        ``mjwarp``.
    """
    others: dict[str, Callable[[EnvConfig, WorldBenchConfig], Speed]] = {}
    if config.opengl:
        others["opengl"] = measure_async_opengl
    if config.mjwarp:
        others["mjwarp"] = measure_mjwarp
    env_config = iter(env_configs(config))

    def add_others(row: dict[str, Any]) -> None:
        task = next(env_config)
        for name, measure in others.items():
            theirs = measure(task, config)
            row |= {f"{name}_{key}": value for key, value in theirs._asdict().items()}
            row[f"ratio_vs_{name}"] = row["steps_per_s"] / theirs.steps_per_s
            row[f"cpu_ratio_vs_{name}"] = (
                row["steps_per_cpu_s"] / theirs.steps_per_cpu_s
            )

    # The others are measured right after KnowArm's row, under the same load of the machine.
    return bench_world(config, on_row=add_others)


def measure_async_opengl(config: EnvConfig, bench: WorldBenchConfig) -> Speed:
    """Measure AsyncVectorEnv in a new process: MuJoCo chooses its OpenGL when it is imported."""
    os.environ.setdefault("MUJOCO_GL", "egl")
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        return pool.submit(_async_worker, config, bench).result()


def _async_worker(config: EnvConfig, bench: WorldBenchConfig) -> Speed:
    """Step single environments with OpenGL, one per process; more than one only waits."""
    # The prefix makes Gymnasium import the package in each worker, which registers the id.
    gym_id = f"knowarm:{env_id(config.robot)}"
    options: dict[str, Any] = {
        "dynamics": config.dynamics,
        "image_size": config.image_size,
        "renderer": "opengl",
        "targets": config.targets,
        "colours": config.colours,
        "task": config.task,
    }
    env = AsyncVectorEnv(
        [lambda: gymnasium.make(gym_id, disable_env_checker=True, **options)]
        * bench.workers,
        autoreset_mode=AutoresetMode.SAME_STEP,
        context="spawn",
    )
    try:
        return measure_steps(env, bench.seconds)
    finally:
        env.close()


def measure_mjwarp(config: EnvConfig, bench: WorldBenchConfig) -> Speed:
    """Measure KnowArm's environment with MuJoCo Warp's images, one process per worker."""
    context = multiprocessing.get_context("spawn")
    share = bench.num_envs // bench.workers
    barrier = context.Barrier(bench.workers)
    with context.Pool(bench.workers, _set_barrier, (barrier,)) as pool:
        tasks = [(config, share, bench.seconds)] * bench.workers
        speeds = pool.starmap(_mjwarp_worker, tasks, chunksize=1)
    return Speed(
        sum(speed.steps_per_s for speed in speeds),
        float(np.mean([speed.steps_per_cpu_s for speed in speeds])),
    )


_barrier: Any = None


def _set_barrier(barrier: Any) -> None:
    """Keep the barrier at which the workers of a pool wait for each other."""
    global _barrier
    _barrier = barrier


def _mjwarp_worker(config: EnvConfig, num_envs: int, seconds: float) -> Speed:
    env = ArmVectorEnv(config, num_envs, num_threads=1)
    env.renderer = MjWarpRenderer(env.scene, config.image_size, num_envs)
    env.reset(seed=0)  # compiles Warp's kernels before the measurement
    _barrier.wait()
    return measure_steps(env, seconds)


class MjWarpRenderer:
    """MuJoCo Warp's ray caster on its CPU device, with the interface of KnowArm's renderers.

    Shadows, specular highlights and emission are off, as in KnowArm's ray caster. Warp uses the
    colours of the model: the target's colour is not randomized, at no cost for Warp.

    Args:
        scene: the rendered scene.
        size: side length of the images [px].
        num_envs: n, the number of worlds.

    Raises:
        UserError: MuJoCo Warp is not installed.
    """

    def __init__(self, scene: Scene, size: int, num_envs: int) -> None:
        try:
            import mujoco_warp
            import warp
        except ImportError as error:
            raise UserError(
                f"This comparison needs MuJoCo Warp ({error}): pip install mujoco-warp warp-lang, "
                "or leave it out with --no-mjwarp."
            ) from None
        warp.config.log_level = warp.LOG_WARNING
        self._mjw: Any = mujoco_warp
        self._size = size
        self._device = warp.ScopedDevice("cpu")
        data = mujoco.MjData(scene.model)
        mujoco.mj_forward(scene.model, data)
        with self._device:
            self._model = mujoco_warp.put_model(scene.model)
            self._data = mujoco_warp.put_data(scene.model, data, nworld=num_envs)
            mujoco_warp.kinematics(self._model, self._data)
            mujoco_warp.camlight(self._model, self._data)
            self._context = mujoco_warp.create_render_context(
                scene.model,
                nworld=num_envs,
                cam_res=(size, size),
                render_rgb=True,
                use_shadows=False,
                enable_specular=False,
                enable_emission=False,
            )
        # Warp's arrays on the CPU device and their NumPy views share memory.
        self._position = self._data.geom_xpos.numpy()
        self._matrix = self._data.geom_xmat.numpy().reshape(num_envs, -1, 9)
        self._packed = self._context.rgb_data.numpy()

    def draw(
        self,
        geom_position: NDArray[np.float64],
        geom_matrix: NDArray[np.float64],
        geom_rgba: NDArray[np.float32],
        views: NDArray[np.float32] | None = None,
        lamps: NDArray[np.float32] | None = None,
    ) -> NDArray[np.uint8]:
        """Render at most n images; see ``knowarm.world.render.renderer.Renderer.draw``."""
        assert views is None
        assert lamps is None
        count = len(geom_position)
        self._position[:count] = geom_position
        self._matrix[:count] = geom_matrix
        self._position[:count, :, 2][geom_rgba[..., 3] == 0] = FAR_BELOW_M
        with self._device:
            self._mjw.refit_bvh(self._model, self._data, self._context)
            self._mjw.render(self._model, self._data, self._context)
        packed = self._packed[:count].reshape(count, self._size, self._size)
        return np.stack(
            [packed >> 16 & 255, packed >> 8 & 255, packed & 255], axis=-1
        ).astype(np.uint8)


def main() -> None:
    config = tyro.cli(CompareWorldConfig, description=__doc__)
    check_output(config.json)
    result = compare_world(config)
    # CPU times are in the JSON only.
    rows = [{k: v for k, v in row.items() if "cpu" not in k} for row in result["rows"]]
    title = (
        f"Environment steps/s with images, {config.workers} threads or processes each"
    )
    print_table(title, list(rows[0]), [list(row.values()) for row in rows])
    write_json_table(config.json, result)


if __name__ == "__main__":
    main()
