"""Asking for a part: the query decides to which part of which object the gripper goes.

Every object has two parts at which it can be grasped, and the facets of a query are parts: only one
part of one of the visible objects answers.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from knowarm.arrays import Floats, Integers
from knowarm.measures import Measure
from knowarm.questions import object_of
from knowarm.world.tasks.asked.query.query import AskObject
from knowarm.world.tasks.asked.query.query_source import GraphQueries, NameQueries
from knowarm.world.tasks.sampling import Setting
from knowarm.world.tasks.state import EpisodeState

PARTS_PER_OBJECT = 2

PURPOSE_TARGETS = (
    *("bottle.stopper", "bottle.neck", "teapot.handle", "teapot.lid", "wine_glass.bowl"),
    *("wine_glass.stem", "vase.flower", "vase.neck", "candle.flame", "candle.wax"),
    *("brush.handle", "brush.block", "clock.rim", "clock.bell", "bell.knob", "bell.handle"),
    *("globe.pin", "globe.stem", "basket.handle", "basket.post"),
)
"""Parts among which is chosen, two of each object."""


@dataclass(frozen=True, kw_only=True)
class AskPart(AskObject):
    """Objects with two parts each, of which exactly one part answers the episode's question."""

    area: ClassVar[str | None] = "purpose"
    targets: ClassVar[tuple[str, ...]] = PURPOSE_TARGETS
    shares_places: ClassVar[bool] = True
    column_meanings: ClassVar[dict[str, str]] = AskObject.column_meanings | {
        "object_correct": "whether the part reached belongs to the object that answers"
    }
    measures: ClassVar[tuple[Measure, ...]] = (
        *AskObject.measures,
        Measure("right_object", "part of the right object", "object_correct"),
    )

    kind: Literal["purpose"] = "purpose"  # type: ignore[assignment]
    """Tag in JSON."""
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

    def nearest(self, state: EpisodeState, points: Floats) -> Integers:
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
