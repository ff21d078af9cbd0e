"""Draw starts of episodes of the choose task, large and as the policy sees them.

python scripts/draw_choose_images.py docs/images/choose.png
"""

import sys

import numpy as np
from PIL import Image

from knowarm.world.config import EnvConfig
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.robots import ROBOTS
from knowarm.world.tasks.asked.query.query import AskObject
from knowarm.world.tasks.task import Task

SIDE, COLUMNS = 200, 6


def enlarged(image: np.ndarray, filter: Image.Resampling) -> np.ndarray:
    """One image at the sheet's size."""
    return np.asarray(Image.fromarray(image).resize((SIDE, SIDE), filter))


def main() -> None:
    """Draw a row of large and a row of small images per robot, and a column per episode."""
    rows = []
    for robot in ROBOTS:
        env = ArmVectorEnv(
            EnvConfig(robot=robot, task=Task(asked=AskObject())), COLUMNS
        )
        small, _ = env.reset(seed=0)
        rows.append(
            [enlarged(image, Image.Resampling.LANCZOS) for image in env.render()]
        )
        rows.append([enlarged(image, Image.Resampling.NEAREST) for image in small])
    Image.fromarray(np.concatenate([np.concatenate(row, axis=1) for row in rows])).save(
        sys.argv[1]
    )


if __name__ == "__main__":
    main()
