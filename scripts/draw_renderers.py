"""Draw the same states by the ray caster and by MuJoCo's OpenGL renderer.

MUJOCO_GL=egl python -m scripts.draw_renderers    # writes to docs/images
"""

from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.sim_to_sim import KINDS, LampRenderer
from knowarm.world.config import EnvConfig
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.render.renderer import OpenGLRenderer
from knowarm.world.scene.appearance import VisualRandomization

IMAGES = Path("docs/images")
ENLARGED = 3
"""Pixels of the sheet for a pixel of an image."""
SEED = 4


def first_image(robot: str, kind: str) -> np.ndarray:
    """Return the first image of an episode, (H, W, 3) uint8, of a kind of `sim_to_sim`."""
    opengl, lamp, varied = KINDS[kind]
    config = EnvConfig(robot=robot, randomization=VisualRandomization(**varied))
    env = ArmVectorEnv(config, 1, num_threads=1)
    if opengl:
        env.renderer = (LampRenderer if lamp else OpenGLRenderer)(
            env.scene, config.image_size
        )
    image = env.reset(seed=SEED)[0][0]
    env.close()
    return image


def save(rows: list[list[np.ndarray]], name: str) -> None:
    """Write a sheet of images, with white lines between them."""
    lines = ((1, 1), (1, 1), (0, 0))
    white = [
        [np.pad(image, lines, constant_values=255) for image in row] for row in rows
    ]
    sheet = np.concatenate([np.concatenate(row, axis=1) for row in white])
    size = sheet.shape[1] * ENLARGED, sheet.shape[0] * ENLARGED
    Image.fromarray(sheet).resize(size, Image.Resampling.NEAREST).save(
        IMAGES / name, optimize=True
    )
    print(f"Wrote {IMAGES / name}")


def main() -> None:
    """Write the sheets of the pages *Rendering* and *Sim to sim*."""
    save([[first_image("tiago", kind) for kind in KINDS]], "sim-to-sim-images.png")
    rows = []
    for robot in ("irb120", "tiago"):
        ours, theirs = (first_image(robot, kind) for kind in ("ray caster", "OpenGL"))
        difference = np.abs(ours.astype(int) - theirs).astype(np.uint8)
        rows.append([ours, theirs, difference])
    save(rows, "rendering.png")


if __name__ == "__main__":
    main()
