"""Physics backends: MuJoCo's thread pool on the CPU, and MuJoCo Warp on the GPU or the CPU.

``Simulator`` is what tasks and renderers use of either. Importing this package imports neither
MuJoCo nor torch.
"""

from typing import Any, Literal, Protocol

from numpy.typing import NDArray

from knowarm.world.arrays import Array, NumpyArrays

SimulatorName = Literal["mujoco", "warp"]
"""Names of the backends."""

Dynamics = Literal["dynamic", "kinematic"]
"""Position servos with inertia and contacts, or joint angles set exactly."""


class Simulator(Protocol):
    """n copies of a scene. Poses are refreshed by ``reset``, ``step`` and ``set_state``.

    Attributes:
        num_envs: n.
        arrays: library, device and precision of all arrays below.
    """

    num_envs: int
    arrays: NumpyArrays

    @property
    def tcp_position(self) -> Array:
        """Position of the gripper, world, (n, 3) [m]."""
        ...

    @property
    def tcp_matrix(self) -> Array:
        """Rotation from gripper to world, row-major, (n, 9)."""
        ...

    @property
    def geom_position(self) -> Array:
        """Positions of the geoms, world, (n, G, 3) [m]."""
        ...

    @property
    def geom_matrix(self) -> Array:
        """Rotations from geom to world, row-major, (n, G, 9)."""
        ...

    @property
    def joint_positions(self) -> Array:
        """Angles of the joints that actions move, (n, J) [rad]."""
        ...

    def reset(
        self,
        selection: Any,
        joint_targets: Array,
        target_position: Array,
        distractor_position: Array | None = None,
    ) -> None:
        """Put selected environments at rest at joint angles, with the targets at a position.

        All arguments are the m rows of ``selection.take``. In a row that is not selected the
        joints keep their angles, and ``joint_targets`` are what the servos already track.

        Args:
            selection: the environments, made by ``arrays``.
            joint_targets: (m, J) [rad].
            target_position: x and y of the K targets, also of hidden ones, (m, K, 2) [m].
            distractor_position: x and y of the distractors, (m, D, 2) [m]; None without any.
        """
        ...

    def step(self, joint_targets: Array) -> None:
        """Advance every environment by one control period towards joint targets (n, J) [rad]."""
        ...

    def get_state(self) -> NDArray[Any]:
        """Copy the state of the physics to the host, (n, S)."""
        ...

    def set_state(
        self,
        state: NDArray[Any],
        joint_targets: Array,
        target_position: Array,
        distractor_position: Array | None,
    ) -> None:
        """Restore a state of ``get_state``, with the arguments of ``reset`` for all rows."""
        ...

    def close(self) -> None:
        """Finish pending work and report problems."""
        ...
