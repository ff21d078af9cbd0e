"""Purpose task: the query decides which part of which object the gripper goes to.

Every object has two parts at which it can be grasped, and the facets of a query are parts: only one
part of one of the visible objects answers. An episode ends where any of them is reached.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from knowarm.arrays import Integers
from knowarm.measures import Measure
from knowarm.questions import object_of
from knowarm.world.tasks.choose.choose import Choose
from knowarm.world.tasks.choose.query_source import GraphQueries, NameQueries
from knowarm.world.tasks.sampling import Setting
from knowarm.world.tasks.state import EpisodeState

PARTS_PER_OBJECT = 2

PURPOSE_TARGETS = (
    *("bottle.stopper", "bottle.neck", "teapot.handle", "teapot.lid", "wine_glass.bowl"),
    *("wine_glass.stem", "vase.flower", "vase.neck", "candle.flame", "candle.wax"),
    *("brush.handle", "brush.block", "clock.rim", "clock.bell", "bell.knob", "bell.handle"),
    *("globe.pin", "globe.stem", "basket.handle", "basket.post"),
)
"""Parts of the purpose task, two of each object."""


@dataclass(frozen=True, kw_only=True)
class Purpose(Choose):
    """Objects with two parts each, of which exactly one part answers the episode's question."""

    area: ClassVar[str] = "purpose"
    targets: ClassVar[tuple[str, ...]] = PURPOSE_TARGETS
    column_meanings: ClassVar[dict[str, str]] = Choose.column_meanings | {
        "object_correct": "whether the part reached belongs to the object that answers"
    }
    measures: ClassVar[tuple[Measure, ...]] = (
        *Choose.measures,
        Measure("right_object", "part of the right object", "object_correct"),
    )

    kind: Literal["purpose"] = "purpose"  # type: ignore[assignment]
    """Tag of this task in JSON."""
    objects: int = 2
    """Objects per episode, 2 to 6, all different, with two parts each."""
    queries: GraphQueries | NameQueries = field(
        default_factory=partial(GraphQueries, graph="purposes", hold_out=("S4", "S2"))
    )
    """Where the questions come from, and which parts answer them."""

    @property
    def visible(self) -> int:
        """Number of parts that an episode shows."""
        return self.objects * PARTS_PER_OBJECT

    def nearest(self, state: EpisodeState) -> Integers:
        """Return the part whose grasp frame is nearest in units of the thresholds, (n,) int64.

        Parts are near each other, and may differ in the angle more than in the distance.
        """
        count = state.objects.shape[1]
        every = [state.measure_object(np.full(len(state.steps), j)) for j in range(count)]
        return np.argmin(np.tensordot(every, 1 / state.limits, axes=(1, 0)), axis=0)

    def columns(
        self, setting: Setting, infos: Mapping[str, NDArray[Any]]
    ) -> dict[str, NDArray[Any]]:
        """Return also whether the part reached belongs to the right object."""
        objects = np.array([object_of(target.name) for target in setting.scene.targets])
        right = objects[infos["reached_object"]] == objects[infos["target"]]
        return super().columns(setting, infos) | {"object_correct": right}
