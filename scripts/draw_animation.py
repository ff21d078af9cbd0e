"""Draw the README's animation: a trained policy answers questions of the choose task.

python scripts/draw_animation.py --run zoo/irb120-choose-subgraph-fast --out docs/images/choose.gif
"""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from knowarm import evaluation_episodes, load_agent
from knowarm.world.envs.vector_env import ReachVectorEnv
from knowarm.world.viewing.record import Frame, record_episode

SIDE, MARGIN, LINE = 300, 8, 30
PAPER, INK, GREEN = (255, 255, 255), (30, 30, 30), (0, 110, 50)
FRAME_MS, LAST_MS = 90, 1_400


def draw(frame: Frame) -> Image.Image:
    """Draw question, large view and the policy's image."""
    sheet = Image.new("RGB", (2 * SIDE + 3 * MARGIN, SIDE + 2 * LINE + MARGIN), PAPER)
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(17)
    query, _, answer = frame.goal.partition(": ")
    pen.text((MARGIN, 6), f"Query: {query}", INK, font)
    if frame.success:
        pen.text((SIDE + 2 * MARGIN, 6), f"Reached {answer}", GREEN, font)
    for column, image in enumerate((frame.large, frame.policy)):
        resample = Image.Resampling.LANCZOS if column == 0 else Image.Resampling.NEAREST
        small = Image.fromarray(image).resize((SIDE, SIDE), resample)
        sheet.paste(small, (MARGIN + column * (SIDE + MARGIN), LINE))
    small_font = ImageFont.load_default(13)
    for column, text in enumerate((f"step {frame.step}", "what the policy sees: 64 x 64")):
        at = (MARGIN + column * (SIDE + MARGIN), SIDE + LINE + 4)
        pen.text(at, text, INK, small_font)
    return sheet


def main() -> None:
    """Play the episodes and write the animation."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--run", default="zoo/irb120-choose-subgraph-fast")
    parser.add_argument("--out", type=Path, default=Path("docs/images/choose.gif"))
    parser.add_argument("--episodes", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    trained = load_agent(arguments.run)
    env = ReachVectorEnv(trained.config.env, 1)
    episodes = evaluation_episodes(env.config, arguments.episodes, arguments.seed)
    images: list[Image.Image] = []
    durations: list[int] = []
    for i in range(len(episodes)):
        frames = record_episode(trained.agent, env, episodes[i : i + 1])
        images += [draw(frame) for frame in frames]
        durations += [FRAME_MS] * (len(frames) - 1) + [LAST_MS]
    palette = images[0].quantize(96)
    stack = [np.asarray(image) for image in images]
    small = [
        Image.fromarray(image).quantize(palette=palette, dither=Image.Dither.NONE)
        for image in stack
    ]
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    small[0].save(arguments.out, save_all=True, append_images=small[1:], duration=durations, loop=0)
    print(f"Wrote {arguments.out}: {len(images)} images, {arguments.out.stat().st_size:,} bytes")


if __name__ == "__main__":
    main()
