"""Selections, and the same episodes and looks from NumPy arrays and from tensors."""

from dataclasses import fields

import numpy as np
import pytest
import torch

from knowarm.world.appearance import AppearanceSource
from knowarm.world.arrays import IndexSelection, MaskSelection
from knowarm.world.config import EnvConfig
from knowarm.world.draws import uniforms
from knowarm.world.episodes import EpisodeSource
from knowarm.world.held_out import HeldOut
from knowarm.world.robots import MAIN_ROBOTS
from knowarm.world.scene import Scene, load_scene, target_places
from knowarm.world.visual_randomization import VisualRandomization

EVERYTHING = VisualRandomization(
    light=0.3,
    light_angle_deg=15,
    camera_shift_m=0.05,
    camera_turn_deg=2,
    surface_colour=0.15,
    distractors=3,
)
STREAMS = np.array([0, 1, 7, 2**63 - 1, 2**63, 2**64 - 1] * 50, dtype=np.uint64)
NUMBERS = np.arange(len(STREAMS), dtype=np.uint64)


def as_tensor(array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(array.view(np.int64))


def scene_of(config: EnvConfig) -> Scene:
    return load_scene(config.robot, tuple(config.targets), config.randomization.distractors)


def test_torch_draws_the_same_uniforms() -> None:
    numbers = uniforms(STREAMS, NUMBERS, 40)
    drawn = uniforms(as_tensor(STREAMS), as_tensor(NUMBERS), 40)
    assert drawn.dtype == torch.float64
    assert drawn.numpy().tobytes() == numbers.tobytes()


@pytest.mark.parametrize("robot", MAIN_ROBOTS)
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"colours": "randomized", "randomization": EVERYTHING},
        {"colours": "randomized", "held_out": HeldOut(colours=("blue",), places=(0, 1, 0, 1))},
        {"held_out": HeldOut(places=(-1, 0, -0.5, 1), play="held_out")},
    ],
    ids=["plain", "looks", "rest", "held_out"],
)
def test_torch_draws_the_same_episodes(robot: str, options: dict) -> None:
    config = EnvConfig(robot=robot, **options)
    scene = scene_of(config)
    episodes = EpisodeSource(scene, config)(STREAMS, NUMBERS)
    drawn = EpisodeSource(scene, config, torch.as_tensor)(as_tensor(STREAMS), as_tensor(NUMBERS))
    for field in fields(episodes):
        expected, got = getattr(episodes, field.name), getattr(drawn, field.name)
        assert isinstance(got, torch.Tensor)
        assert got.numpy().dtype == expected.dtype, field.name
        assert (got.numpy() == expected).all(), field.name
    assert (
        target_places(scene, drawn.position).numpy() == target_places(scene, episodes.position)
    ).all()


@pytest.mark.parametrize("robot", MAIN_ROBOTS)
@pytest.mark.parametrize("randomization", [VisualRandomization(), EVERYTHING])
def test_torch_shows_the_same_looks(robot: str, randomization: VisualRandomization) -> None:
    config = EnvConfig(robot=robot, colours="randomized", randomization=randomization)
    scene = scene_of(config)
    e = EpisodeSource(scene, config)(STREAMS, NUMBERS)
    given = e.target, e.colour, e.position, e.look
    expected = AppearanceSource(scene, randomization)(*given)
    shown = AppearanceSource(scene, randomization, torch.as_tensor)(*map(torch.as_tensor, given))
    for name, want, got in zip(expected._fields, expected, shown, strict=True):
        if want is None:
            assert got is None, name
            continue
        assert got.numpy().dtype == want.dtype, name
        assert got.numpy() == pytest.approx(want, abs=1e-6), name


def test_selections_by_index_and_by_mask_agree() -> None:
    values = np.arange(12.0).reshape(6, 2)
    ids = np.array([0, 3, 5])
    mask = np.isin(np.arange(6), ids)
    by_index, by_mask = IndexSelection(ids), MaskSelection(torch.as_tensor(mask))
    new = -values
    first = by_index.put(values, by_index.take(new))
    second = by_mask.put(torch.as_tensor(values), by_mask.take(torch.as_tensor(new)))
    assert (first == second.numpy()).all()
    assert (first[mask] == new[mask]).all()
    assert (first[~mask] == values[~mask]).all()
    assert (values >= 0).all(), "the argument is not written into"
    assert IndexSelection(ids[:0]).is_empty
    assert not by_index.is_empty
