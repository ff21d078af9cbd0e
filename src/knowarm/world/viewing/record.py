"""Recording of played episodes as film strips, videos and pages with films."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import chain, repeat
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from knowarm.arrays import Floats, Images
from knowarm.errors import UserError
from knowarm.pictures import animation, check_suffix, data_uri
from knowarm.reading import replacing, write_text
from knowarm.svg import render_page
from knowarm.world.agents.play import play_steps
from knowarm.world.agents.protocol import AgentProtocol
from knowarm.world.envs.vector_env import RENDER_SIZE, ArmVectorEnv
from knowarm.world.scene.scene import project
from knowarm.world.tasks.sampling import Episodes

# Frames per second of the video: one per step, the speed of the real robot
FRAMES_PER_S = 10
FRAME_MS = 1000 // FRAMES_PER_S
_LAST_FRAMES = 10
_LAST_MS = 1_500  # Display time of the last image of a page's film [ms]
_MARGIN = 8
_LINE = 28
_PAPER = (255, 255, 255)
_INK = (30, 30, 30)
LENGTH_M = 0.08  # Length of a drawn axis [m]
_SPHERE_POINTS = 64
_COLOURS = ((214, 39, 40), (44, 160, 44), (31, 119, 180))  # of the x, y and z axis
# Size of a frame of a film [px]
_SHEET = (2 * RENDER_SIZE + 3 * _MARGIN, RENDER_SIZE + 44)


@dataclass(frozen=True, kw_only=True)
class Frame:
    """One frame of a recorded episode."""

    policy: Images  # Observation of the policy, (H, W, 3)
    large: Images  # The same view, enlarged, (480, 480, 3)
    step: int  # Steps played so far
    distance: float  # Gripper to grasp point [m]
    angle: float  # Angle between gripper and grasp frame [deg]
    success: bool  # Whether the target is reached
    joints: Floats  # Joint angles, (J,) [rad] (slides: [m])
    goal: str = ""  # What the episode's goal is, as "red mug", for captions


def record_episode(
    agent: AgentProtocol, env: ArmVectorEnv, episode: Episodes, *, axes: bool = False
) -> list[Frame]:
    """Play one episode in one environment and keep every frame, from the start pose to the end.

    With ``axes``, both frames and the sphere of success are drawn over the large view.
    """
    frames = []
    for moment in play_steps(agent, env, episode):
        large = env.render()[0]
        if axes:
            large = draw_axes(env, large)
        infos = moment.infos
        frame = Frame(
            policy=moment.images[0].copy(),
            large=large,
            step=moment.step,
            distance=float(infos["distance"][0]),
            angle=float(infos["angle"][0]),
            success=bool(infos["is_success"][0]),
            joints=env.joint_positions[0].copy(),
            goal=env.running.describe(0),
        )
        frames.append(frame)
    return frames


def draw_axes(env: ArmVectorEnv, image: Images) -> Images:
    """Draw both frames of environment 0 over its image (H, H, 3) uint8: a new image.

    The axes x, y and z are red, green and blue, thick for the goal and thin for the gripper, and
    are drawn over what hides them. The circle is the outline of the sphere around the goal in
    which the gripper's distance counts as success.
    """
    running = env.running
    simulator = running.simulator
    scene = env.scene
    view = np.append(scene.camera_position, scene.camera_matrix)
    if running.shown.views is not None:
        view = running.shown.views[0]
    goal = running.goal_position[0]
    _, _, rotation = np.linalg.svd((goal - view[:3])[None])
    right, up = rotation[1:]  # span the plane across the line of sight
    turn = np.linspace(0, 2 * np.pi, _SPHERE_POINTS)[:, None]
    circle = np.cos(turn) * right + np.sin(turn) * up
    lines = [(goal + running.limits[0] * circle, _PAPER, 2)]
    frames = (
        (goal, running.goal_matrix[0], 4),
        (simulator.tcp_position[0], simulator.tcp_matrix[0], 2),
    )
    for origin, matrix, width in frames:
        for axis, colour in zip(matrix.reshape(3, 3).T, _COLOURS, strict=True):
            end = origin + LENGTH_M * axis
            lines.append((np.stack([origin, end]), colour, width))
    drawing = Image.fromarray(image)
    draw = ImageDraw.Draw(drawing)
    for points, colour, width in lines:
        pixels = (1 + project(scene, points, view) * (1, -1)) * len(image) / 2
        if np.isfinite(pixels).all():  # in front of the camera
            draw.line(list(map(tuple, pixels)), colour, width)
    return np.asarray(drawing)


def check_video(path: Path) -> None:
    """Raise a `UserError` unless a video can be written to a file."""
    if find_spec("av") is None:
        raise UserError("Videos need PyAV: pip install 'knowarm[video]'.")
    if path.suffix.lower() != ".mp4":
        raise UserError(f"The video must be an .mp4 file, got {path.name!r}.")


def check_page(path: Path) -> None:
    """Raise a `UserError` unless a file is named as a page."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise UserError(f"The page must be an .html file, got {path.name!r}.")


def write_strip(
    path: Path, episodes: Sequence[Sequence[Frame]], columns: int = 6
) -> None:
    """Write a film strip: one row per episode, frames evenly spaced from start to end.

    The goal of an episode stands above its row; the suffix of the file selects the format.
    """
    check_suffix(path, "A film strip")
    side = 240
    title = _LINE if any(frames[0].goal for frames in episodes) else 0
    column_width = side + _MARGIN
    row_height = title + side + _LINE + _MARGIN
    size = (columns * column_width + _MARGIN, len(episodes) * row_height + _MARGIN)
    strip = Image.new("RGB", size, _PAPER)
    draw = ImageDraw.Draw(strip)
    font = ImageFont.load_default(14)
    top = _MARGIN + title
    for frames in episodes:
        draw.text((_MARGIN, top - 22), frames[0].goal, _INK, font)
        chosen = np.unique(np.linspace(0, len(frames) - 1, columns).round().astype(int))
        left = _MARGIN
        for index in chosen:
            frame = frames[index]
            large = Image.fromarray(frame.large)
            large = large.resize((side, side), Image.Resampling.LANCZOS)
            strip.paste(large, (left, top))
            draw.text((left, top + side + 5), _caption(frame), _INK, font)
            left += column_width
        top += row_height
    with replacing(path, "Name another file.") as temporary:
        strip.save(temporary)


def write_video(path: Path, episodes: Iterable[Sequence[Frame]]) -> None:
    """Write an H.264 video with the policy's observation beside the enlarged view."""
    check_video(path)
    import av

    with (
        replacing(path, "Name another file.") as temporary,
        av.open(str(temporary), "w") as container,
    ):
        stream = container.add_stream("libx264", rate=FRAMES_PER_S)
        stream.width, stream.height = _SHEET
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "20"}
        for frames in episodes:
            for frame in chain(frames, repeat(frames[-1], _LAST_FRAMES)):
                image = av.VideoFrame.from_ndarray(_side_by_side(frame), format="rgb24")
                container.mux(stream.encode(image))
        container.mux(stream.encode())


def write_page(path: Path, title: str, episodes: Sequence[Sequence[Frame]]) -> None:
    """Write a self-contained HTML page with a film per episode, which a browser repeats."""
    films = []
    for frames in episodes:
        images = list(map(_side_by_side, frames))
        last = frames[-1]
        film = {
            "source": data_uri("WEBP", animation(images, FRAME_MS, _LAST_MS)),
            "goal": last.goal,
            "outcome": "reached" if last.success else "failed",
            "steps": last.step,
        }
        films.append(film)
    write_html(path, "films.html.j2", title=title, films=films)


def write_html(path: Path, template: str, **values: Any) -> None:
    """Write a self-contained HTML page of a template of this folder."""
    check_page(path)
    text = render_page(__package__, template, **values)
    write_text(path, text, "Name another file.")


def _side_by_side(frame: Frame) -> Images:
    """Draw the policy's image, its pixels enlarged, and the large view: (H, W, 3), even sides."""
    sheet = Image.new("RGB", _SHEET, _PAPER)
    size = (RENDER_SIZE, RENDER_SIZE)
    small = Image.fromarray(frame.policy).resize(size, Image.Resampling.NEAREST)
    sheet.paste(small, (_MARGIN, _MARGIN))
    sheet.paste(Image.fromarray(frame.large), (RENDER_SIZE + 2 * _MARGIN, _MARGIN))
    caption = _caption(frame)
    if frame.goal:
        caption = f"{frame.goal}; {caption}"
    font = ImageFont.load_default(16)
    place = (_MARGIN, RENDER_SIZE + _MARGIN + 6)
    ImageDraw.Draw(sheet).text(place, caption, _INK, font)
    return np.asarray(sheet)


def _caption(frame: Frame) -> str:
    reached = ", reached" if frame.success else ""
    return f"step {frame.step}: {100 * frame.distance:.1f} cm, {frame.angle:.0f} deg{reached}"
