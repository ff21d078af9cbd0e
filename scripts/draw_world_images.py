"""Draw both robots with all targets and colours, large and as the policy sees them.

python scripts/draw_world_images.py docs/images/world.png
"""

import sys

import numpy as np
from PIL import Image

from knowarm.world.config import EnvConfig
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.robots import ROBOTS

SIDE = 240


def enlarged(image: np.ndarray, filter: Image.Resampling) -> np.ndarray:
    """One image at the sheet's size."""
    return np.asarray(Image.fromarray(image).resize((SIDE, SIDE), filter))


def main() -> None:
    """Draw a row of large and a row of small images per robot, and a column per colour."""
    rows = []
    for robot in ROBOTS:
        env = ArmVectorEnv(EnvConfig(robot=robot, colours="randomized"), 60)
        small, infos = env.reset(seed=3)
        large = env.render()
        chosen = [
            int(np.argmax(infos["facet"] == facet)) for facet in range(len(env.facets))
        ]
        rows.append([enlarged(large[i], Image.Resampling.LANCZOS) for i in chosen])
        rows.append([enlarged(small[i], Image.Resampling.NEAREST) for i in chosen])
    Image.fromarray(np.concatenate([np.concatenate(row, axis=1) for row in rows])).save(
        sys.argv[1]
    )


if __name__ == "__main__":
    main()
