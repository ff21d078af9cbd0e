"""Draw the README's animation: a trained policy answers questions of the choose task.

python scripts/draw_animation.py --run zoo/irb120-choose-answers-fast --out docs/images/choose.gif
"""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from knowarm import evaluation_episodes, load_agent
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.viewing.record import Frame, record_episode

SIDE, MARGIN, LINE = 300, 8, 36
PAPER, INK, GREEN = (255, 255, 255), (30, 30, 30), (0, 110, 50)
FRAME_MS, LAST_MS = 90, 1_400


def draw(frame: Frame, last: bool) -> Image.Image:
    """Draw question, large view, the policy's image and, below them, the outcome."""
    sheet = Image.new("RGB", (2 * SIDE + 3 * MARGIN, SIDE + 2 * LINE), PAPER)
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(25)
    query, _, answer = frame.goal.partition(": ")
    pen.text((MARGIN, 4), query, INK, font)
    found = (
        f"{'Reached' if frame.success else 'Missed'} {answer}"
        if last
        else f"step {frame.step}"
    )
    pen.text((MARGIN, LINE + SIDE + 4), found, GREEN if frame.success else INK, font)
    for column, image in enumerate((frame.large, frame.policy)):
        resample = Image.Resampling.LANCZOS if column == 0 else Image.Resampling.NEAREST
        small = Image.fromarray(image).resize((SIDE, SIDE), resample)
        sheet.paste(small, (MARGIN + column * (SIDE + MARGIN), LINE))
    at = (2 * (SIDE + MARGIN), LINE + SIDE + 10)
    pen.text(
        at,
        "64 x 64 pixels: the policy's input",
        INK,
        ImageFont.load_default(16),
        anchor="ra",
    )
    return sheet


def main() -> None:
    """Play the episodes and write the animation."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--run", default="zoo/irb120-choose-answers-fast")
    parser.add_argument("--out", type=Path, default=Path("docs/images/choose.gif"))
    parser.add_argument("--episodes", type=int, default=4)
    # In the first one a book hides what is meant.
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    trained = load_agent(arguments.run)
    env = ArmVectorEnv(trained.config.env, 1)
    episodes = evaluation_episodes(env.config, arguments.episodes, arguments.seed)
    images: list[Image.Image] = []
    durations: list[int] = []
    for i in range(arguments.first, len(episodes)):
        frames = record_episode(trained.agent, env, episodes[i : i + 1])
        images += [draw(frame, frame is frames[-1]) for frame in frames]
        durations += [FRAME_MS] * (len(frames) - 1) + [LAST_MS]
    # Colours of all episodes
    every = np.concatenate([np.asarray(image) for image in images[::4]])
    palette = Image.fromarray(every).quantize(192)
    small = [
        image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images
    ]
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    small[0].save(
        arguments.out,
        save_all=True,
        append_images=small[1:],
        duration=durations,
        loop=0,
    )
    print(
        f"Wrote {arguments.out}: {len(images)} images, {arguments.out.stat().st_size:,} bytes"
    )


if __name__ == "__main__":
    main()
