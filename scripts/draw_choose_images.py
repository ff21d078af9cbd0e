"""Draw starts of episodes of the choice task, large and as the policy sees them.

python scripts/draw_choose_images.py docs/images/choose.png
"""

import sys

import numpy as np
from PIL import Image

from knowarm.world.config import choice_env_config
from knowarm.world.robots import MAIN_ROBOTS
from knowarm.world.vector_env import ReachVectorEnv

SIDE, COLUMNS = 200, 6


def enlarged(image: np.ndarray, filter: Image.Resampling) -> np.ndarray:
    """One image at the sheet's size."""
    return np.asarray(Image.fromarray(image).resize((SIDE, SIDE), filter))


def main() -> None:
    """Draw a row of large and a row of small images a robot, a column an episode."""
    rows = []
    for robot in MAIN_ROBOTS:
        env = ReachVectorEnv(choice_env_config(robot), COLUMNS)
        small, _ = env.reset(seed=0)
        rows.append([enlarged(image, Image.Resampling.LANCZOS) for image in env.render()])
        rows.append([enlarged(image, Image.Resampling.NEAREST) for image in small])
    Image.fromarray(np.concatenate([np.concatenate(row, axis=1) for row in rows])).save(sys.argv[1])


if __name__ == "__main__":
    main()
