"""Images by MuJoCo's OpenGL renderer, drawn in a process of their own.

MuJoCo selects an OpenGL library when it is first imported and aborts the interpreter if that fails,
so tests run this file as a program: ``opengl_images.py model.mjb poses.npz images.npy``.
"""

import os
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray


class NoOpenGL(Exception):
    """MuJoCo's renderer does not run on this machine; the message gives the reasons."""


def opengl_images(
    model: mujoco.MjModel,
    camera: int,
    geom_xpos: NDArray[np.float64],
    geom_xmat: NDArray[np.float64],
    size: int,
    samples: int,
    folder: Path,
) -> NDArray[np.uint8]:
    """Draw geom poses with MuJoCo's renderer, shadows and reflections off, (n, size, size, 3)."""
    mujoco.mj_saveModel(model, str(folder / "model.mjb"))
    np.savez(
        folder / "poses.npz",
        geom_xpos=geom_xpos, geom_xmat=geom_xmat, camera=camera, size=size, samples=samples,
    )  # fmt: skip
    names = [str(folder / name) for name in ("model.mjb", "poses.npz", "images.npy")]
    reasons = []
    for library in (os.environ.get("MUJOCO_GL"), "egl", "osmesa"):
        if library is None:
            continue
        done = subprocess.run(
            [sys.executable, __file__, *names],
            env=os.environ | {"MUJOCO_GL": library},
            capture_output=True,
            text=True,
        )
        if done.returncode == 0:
            return np.load(names[2])
        lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        reasons.append(f"{library}: {lines[-1]}")
    raise NoOpenGL("MuJoCo's renderer found no OpenGL (" + "; ".join(reasons) + ")")


def main(model_file: str, poses_file: str, images_file: str) -> None:
    """Draw the poses of a file with the model of another and write the images."""
    model, given = mujoco.MjModel.from_binary_path(model_file), np.load(poses_file)
    size, camera = int(given["size"]), int(given["camera"])
    model.vis.quality.offsamples = int(given["samples"])
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    images = []
    with mujoco.Renderer(model, size, size) as renderer:
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        for position, matrix in zip(
            given["geom_xpos"], given["geom_xmat"], strict=True
        ):
            data.geom_xpos[:], data.geom_xmat[:] = position, matrix
            renderer.update_scene(data, camera)
            images.append(renderer.render())
    np.save(images_file, np.array(images))


if __name__ == "__main__":
    main(*sys.argv[1:])
