"""Tests of the estimated bytes and operations per step, against hand counts and torch."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from knowarm.bench.gpu_estimate import (
    NO_GEOM,
    activations,
    environment_bytes,
    forward_operations,
    ray_operations,
    tile_operations,
    training_bytes,
    training_operations,
    world_bytes,
)
from knowarm.policy import Policy, PolicyConfig, PolicyShape
from knowarm.world.config import EnvConfig
from knowarm.world.render.intersections import BOX, CYLINDER, MESH
from knowarm.world.scene import load_scene
from knowarm.world.vector_env import ReachVectorEnv

FIRST = 2 * (9 * 4) * 27 * 16
"""Nine blocks of four patches of 27 pixel values, 16 channels."""
SECOND = 2 * 32 * (9 * 64)
"""One position of 32 channels, of 3 x 3 blocks with 64 channels."""
FORWARD = FIRST + SECOND + 2 * (32 * 16 + 4 * 28 * (28 + 28) + 28 * 6 + 28)


@pytest.fixture
def policy() -> Policy:
    shape = PolicyShape(joints=2, levels=3, image_size=24, knowledge_dim=12)
    return Policy(PolicyConfig(features=16), shape, torch.zeros(1, 12))


def test_operations_are_those_counted_by_hand(policy: Policy) -> None:
    assert forward_operations(policy) == FORWARD == 81_928
    assert training_operations(policy, epochs=2) == FORWARD + 2 * (3 * FORWARD - FIRST)


def test_operations_are_those_torch_counts(policy: Policy) -> None:
    steps, batch = 5, 3
    image = torch.zeros(steps, batch, 24, 24, 3, dtype=torch.uint8)
    facet = torch.zeros(steps, batch, dtype=torch.int64)
    start = torch.zeros(steps, batch, dtype=torch.bool)
    patches, state = policy.patches(image), policy.initial_state(batch)
    with FlopCounterMode(display=False) as counter:
        policy.step(patches[0], facet[0], state, start[0])
    assert counter.get_total_flops() == batch * forward_operations(policy)
    with FlopCounterMode(display=False) as counter:
        logits, value, _ = policy.unroll(patches, facet, state, start)
        (logits.sum() + value.sum()).backward()
    learning = training_operations(policy, epochs=1) - forward_operations(policy)
    assert counter.get_total_flops() == steps * batch * learning


def test_bytes_of_training_are_those_counted_by_hand(policy: Policy) -> None:
    pixels, active = 9 * 108, 9 * 4 * 16 + 32 + 16 + 7 * 28 + 2 * 3 + 1
    assert activations(policy) == active == 827
    image = 3 * 24 * 24
    found = training_bytes(policy, EnvConfig(image_size=24), epochs=2, item=4)
    assert found == image + 4 * pixels + 8 * (pixels + active) + 8 * (3 * pixels + 5 * active)
    assert found == 76_416


def test_bytes_of_worlds_leave_out_room_for_contacts() -> None:
    @dataclass
    class Contact:
        dist: object

    @dataclass
    class Data:
        nworld: int
        qpos: object
        qvel: object
        contact: Contact
        map_efc2iefc: object

    def array(size: int) -> SimpleNamespace:
        return SimpleNamespace(capacity=size)

    assert world_bytes(Data(2, array(40), array(24), Contact(array(1000)), array(500))) == 64


def test_bytes_of_an_environment_grow_with_its_image() -> None:
    pytest.importorskip("mujoco_warp")
    config = EnvConfig()
    scene = load_scene(config.robot, tuple(config.targets), 0)
    small, large = (environment_bytes(scene, EnvConfig(image_size=side)) for side in (32, 64))
    assert large - small == 3 * (64**2 - 32**2)
    # Records of 27 + 6 numbers a geom, written and read; the rest is physics, five substeps.
    physics = small - 3 * 32**2 - 2 * 4 * (27 + 6) * scene.model.ngeom
    assert physics > 0
    assert physics % (2 * 5 * 4) == 0


def test_a_geom_is_met_in_every_sample_of_its_tiles() -> None:
    extent = np.array(
        [
            [BOX, 0, 0, 5, 4, 4],  # columns of two tiles, rows of one
            [CYLINDER, 1, 3, 4, 3, 8],  # of two, of three
            [MESH, 2, 0, 63, 0, 255],  # not counted
            [NO_GEOM, 3, 0, 63, 0, 255],
        ],
        dtype=np.int32,
    )
    assert tile_operations(extent) == 2 * 16 * 56 + 6 * 16 * 74


def test_rays_of_a_scene_are_counted_in_its_images() -> None:
    env = ReachVectorEnv(EnvConfig(), 3, 1)
    env.reset(seed=0)
    state = env.simulation.geom_position, env.simulation.geom_matrix, env.geom_rgba
    found = ray_operations(env.scene, env.config, *state)
    # At least every twentieth sample meets something, and none meets everything.
    samples, moving = 4 * 64 * 64, env.scene.model.ngeom
    assert 0.05 * samples * 56 < found < samples * moving * 74
    hidden = np.zeros_like(env.geom_rgba)
    assert ray_operations(env.scene, env.config, *state[:2], hidden) == 0
