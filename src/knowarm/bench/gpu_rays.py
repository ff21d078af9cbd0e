"""States of environments go in; how many operations their rays take to be met comes out."""

import numpy as np
from numpy.typing import NDArray

from knowarm.world.config import EnvConfig
from knowarm.world.render import Raycaster
from knowarm.world.render.intersections import BOX, CAPSULE, CYLINDER, ELLIPSOID, PLANE, SPHERE
from knowarm.world.render.tiles import BITS, TILE
from knowarm.world.scene import Scene

NO_GEOM = -1

TEST_OPERATIONS = {PLANE: 25, SPHERE: 64, CAPSULE: 164, ELLIPSOID: 80, CYLINDER: 74, BOX: 56}
"""Operations of meeting one sample with one geom, by type, counted in ``intersections.py``: an
addition, multiplication, division, root, comparison, minimum or choice is one, and 12 turn the ray
into the geom's frame. Triangles of meshes are not counted."""


def ray_operations(
    scene: Scene,
    config: EnvConfig,
    positions: NDArray[np.float32],
    matrices: NDArray[np.float32],
    rgba: NDArray[np.float32],
) -> float:
    """Mean number of operations that one image's rays take.

    A geom is met in every sample of the tiles (4 x 4 samples) that its bounds touch; geoms that
    stand still are in a kept image and cost nothing. The walk past geoms that are not near, and
    the shading, are left out.

    Args:
        scene: what is drawn.
        config: side and anti-aliasing of the images.
        positions: (n, G, 3) of the geoms [m], world.
        matrices: (n, G, 9), rotation from geom to world.
        rgba: (n, G, 4) colours; alpha 0 hides.
    """
    caster = _CountingRaycaster(
        scene.model,
        scene.camera,
        config.image_size,
        config.image_size,
        antialiasing=config.antialiasing,
    )
    counts = [caster.operations(*state) for state in zip(positions, matrices, rgba, strict=True)]
    return float(np.mean(counts))


class _CountingRaycaster(Raycaster):
    """Draws one image and looks at what the drawing left behind."""

    def operations(
        self,
        position: NDArray[np.float32],
        matrix: NDArray[np.float32],
        rgba: NDArray[np.float32],
    ) -> int:
        """Operations of one state's image; arguments as ``Raycaster.draw``'s, without n."""
        extent = self._scratch[0].extent
        extent[:, 0] = NO_GEOM
        self.draw(position[None], matrix[None], rgba[None])
        return tile_operations(extent)


def tile_operations(extent: NDArray[np.int32]) -> int:
    """Operations of meeting geoms in the tiles that they touch.

    Args:
        extent: (G, 6) kind (-1 for none), geom, first and last column and row of samples.
    """
    columns = (extent[:, 3] >> BITS) - (extent[:, 2] >> BITS) + 1
    rows = (extent[:, 5] >> BITS) - (extent[:, 4] >> BITS) + 1
    samples = columns * rows * TILE * TILE
    each = np.array([TEST_OPERATIONS.get(int(kind), 0) for kind in extent[:, 0]])
    return int((samples * each).sum())
