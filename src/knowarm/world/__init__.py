"""MJCF files, seeds and actions go in; images, rewards and episodes come out.

The data's way: ``robots`` and ``objects`` -> ``scene`` -> ``simulation`` -> ``images`` (drawn by
``raycast``) and ``rewards`` -> ``env``. Importing this package imports no simulator.
"""

import gymnasium

ENV_IDS = {"knowarm/IRB120Reach-v0": "irb120", "knowarm/TiagoReach-v0": "tiago"}
"""Robot behind each Gymnasium id."""


def register_environments() -> None:
    """Register the Gymnasium ids, for ``gymnasium.make`` and ``gymnasium.make_vec``."""
    for env_id, robot in ENV_IDS.items():
        if env_id not in gymnasium.registry:
            gymnasium.register(
                env_id,
                entry_point="knowarm.world.single:ReachEnv",
                vector_entry_point="knowarm.world.single:make_vector_env",
                kwargs={"robot": robot},
            )
