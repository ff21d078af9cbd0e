"""A model goes in; how many contacts and constraint rows Warp sets memory aside for comes out."""

from typing import NamedTuple

import mujoco
import numpy as np

CONTACTS_PER_WORLD = 32
"""Contacts set aside for each world; all worlds share them. Arms that are pressed into the floor
with all their might had 12 a world on average, at random play it is one in ten worlds."""

ROWS_PER_WORLD = 256
"""Most constraint rows of a world; such arms had up to 176."""

CONVEX_PER_WORLD = 4
"""Contacts found iteratively (a cylinder and a box, meshes) for each world, shared likewise."""

_MOST_CONTACTS_OF_A_PAIR = 8


class Capacity(NamedTuple):
    """Sizes of Warp's arrays."""

    contacts: int
    """Contacts of all worlds together."""

    convex: int
    """Those of them that are found iteratively."""

    rows: int
    """Constraint rows of one world."""


def capacity(model: mujoco.MjModel, num_envs: int) -> Capacity:
    """Choose the sizes for n worlds: never more than the model can fill.

    Args:
        model: the scene.
        num_envs: n.
    """
    pairs = int(np.triu(_may_touch(model), 1).sum())
    contacts = pairs * _MOST_CONTACTS_OF_A_PAIR
    # A pyramid of friction has two rows a direction; a joint's limits and friction have one each.
    rows = contacts * max(1, 2 * (int(model.geom_condim.max()) - 1)) + 2 * model.njnt + model.nv
    shared = num_envs * min(contacts, CONTACTS_PER_WORLD) + contacts
    return Capacity(
        contacts=shared,
        convex=min(shared, num_envs * CONVEX_PER_WORLD + contacts),
        rows=min(rows, ROWS_PER_WORLD),
    )


def _may_touch(model: mujoco.MjModel) -> np.ndarray:
    """Whether two geoms of different bodies may meet, (G, G) bool."""
    kind, affinity = model.geom_contype[:, None], model.geom_conaffinity[None, :]
    meet = (kind & affinity) != 0
    body = model.body_weldid[model.geom_bodyid]
    return (meet | meet.T) & (body[:, None] != body[None, :])
