import base64
import io
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from knowarm.errors import UserError
from knowarm.world.agents.scripted import OracleAgent
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.scene.appearance import VisualRandomization
from knowarm.world.tasks.asked.query.query import AskObject
from knowarm.world.viewing.record import (
    record_episode,
    write_page,
    write_strip,
    write_video,
)
from tests.world.helpers import MakeEnv


@pytest.fixture
def films(make_env: MakeEnv) -> list:
    env = make_env(1, image_size=32)
    episodes = evaluation_episodes(env.config, 2, seed=0)
    return [
        record_episode(OracleAgent(env), env, episodes[i : i + 1]) for i in range(2)
    ]


def test_a_recorded_episode_runs_from_the_start_to_success(films: list) -> None:
    for film in films:
        assert [frame.step for frame in film] == list(range(len(film)))
        assert [frame.success for frame in film] == [False] * (len(film) - 1) + [True]
        assert film[-1].distance < 0.05
        assert film[0].policy.shape == (32, 32, 3)
        assert film[0].large.shape == (480, 480, 3)
        assert (film[-1].policy != film[0].policy).any()


def test_a_strip_has_a_row_an_episode(films: list, tmp_path: Path) -> None:
    write_strip(tmp_path / "new" / "strip.png", films, columns=4)
    with Image.open(tmp_path / "new" / "strip.png") as strip:
        image = np.asarray(strip)
    assert image.shape == (2 * (28 + 240 + 36) + 8, 4 * 248 + 8, 3)
    for row in range(2):
        top = 8 + row * 304 + 28
        assert image[top - 28 : top, 8:248].min() < 100, "its goal"
        assert image[top : top + 240, 8:248].std() > 10, "a image"
        assert image[top + 240 : top + 268, 8:248].min() < 100, "its caption"


def test_a_video_holds_every_frame(films: list, tmp_path: Path) -> None:
    av = pytest.importorskip("av", exc_type=ImportError)
    path = tmp_path / "film.mp4"
    write_video(path, films)
    with av.open(str(path)) as container:
        frames = [
            frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)
        ]
    assert len(frames) == sum(len(film) + 10 for film in films)
    assert frames[0].std() > 10
    with pytest.raises(UserError, match=r"must be an .mp4 file, got 'film.gif'"):
        write_video(tmp_path / "film.gif", films)


def test_a_page_holds_every_frame_of_every_episode(films: list, tmp_path: Path) -> None:
    path = tmp_path / "film.html"
    write_page(path, "irb120 <oracle>", films)
    text = path.read_text()
    assert "irb120 &lt;oracle&gt;" in text
    assert "http" not in text, "the page loads nothing"
    stored = re.findall(r'src="data:image/webp;base64,([^"]+)"', text)
    assert len(stored) == len(films)
    for data, film in zip(stored, films, strict=True):
        with Image.open(io.BytesIO(base64.b64decode(data))) as image:
            assert image.n_frames == len(film)
            assert image.info["loop"] == 0
        assert f"reached after {film[-1].step} steps</figcaption>" in text


def test_an_interrupted_video_leaves_the_former_file(
    films: list, tmp_path: Path
) -> None:
    pytest.importorskip("av")
    path = tmp_path / "video.mp4"
    path.write_bytes(b"former")

    def episodes() -> Iterator[list]:
        yield films[0]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video(path, episodes())
    assert path.read_bytes() == b"former"
    assert [each.name for each in tmp_path.iterdir()] == ["video.mp4"]


def test_an_unwritable_or_unknown_file_is_named(films: list, tmp_path: Path) -> None:
    for name in ("strip.nothing", "strip.psd"):  # the second can be read only
        with pytest.raises(
            UserError, match=rf"film strip is an image file .* got '{name}'"
        ):
            write_strip(tmp_path / name, films)
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="Cannot write"):
        write_strip(tmp_path / "file" / "strip.png", films)


def test_a_strip_shows_the_query_above_its_row(tmp_path: Path) -> None:
    env = ArmVectorEnv(
        EnvConfig(task=AskObject(), image_size=16, dynamics="kinematic"), 1
    )
    episodes = evaluation_episodes(env.config, 1, seed=1)
    frames = record_episode(OracleAgent(env), env, episodes)
    assert frames[0].goal.startswith(f"{episodes.question[0]}: the ")
    write_strip(tmp_path / "with.png", [frames])
    write_strip(
        tmp_path / "without.png", [[replace(frame, goal="") for frame in frames]]
    )
    heights = [
        Image.open(tmp_path / f"{name}.png").height for name in ("with", "without")
    ]
    assert heights[0] > heights[1]


@pytest.mark.parametrize("shift", [0.0, 0.1])
def test_axes_are_drawn_where_the_image_shows_the_goal(
    shift: float, make_env: MakeEnv
) -> None:
    """The grasp of a bottle is on its stopper, just above its coloured pixels."""
    env = make_env(
        1, targets=("bottle",), randomization=VisualRandomization(camera_shift_m=shift)
    )
    episodes = evaluation_episodes(env.config, 1, seed=4)
    plain, drawn = (
        record_episode(OracleAgent(env), env, episodes, axes=axes)[0].large.astype(int)
        for axes in (False, True)
    )
    changed = np.argwhere((plain != drawn).any(axis=2))
    circle = np.argwhere((drawn == 255).all(axis=2) & (plain != 255).any(axis=2))
    r, g, b = plain.transpose(2, 0, 1)
    bottle = np.argwhere((r > 100) & (g > 0.8 * r) & (b < 0.5 * g))
    top = bottle[bottle[:, 0] < bottle[:, 0].min() + 6].mean(axis=0)
    assert len(circle) > 50
    assert len(changed) < 0.02 * 480**2
    middle = (circle.min(axis=0) + circle.max(axis=0)) / 2
    radius = (circle.max(axis=0) - circle.min(axis=0)).mean() / 2
    assert np.linalg.norm(top - middle) < 0.7 * radius
