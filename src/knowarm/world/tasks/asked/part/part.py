"""Asking for a part: the query decides to which part of which object the gripper goes.

Every object has two parts at which it can be grasped, and the facets of a query are parts: only one
part of one of the visible objects answers.
"""

from dataclasses import dataclass, field
from functools import partial
from typing import Literal

import numpy as np

from knowarm.arrays import Floats, Integers
from knowarm.measures import Measure
from knowarm.questions import object_of
from knowarm.world.tasks.asked.query.query import AskObject
from knowarm.world.tasks.asked.query.query_source import GraphQueries, NameQueries
from knowarm.world.tasks.sampling import Setting
from knowarm.world.tasks.state import EpisodeState, NamedArrays

PARTS_PER_OBJECT = 2

PURPOSE_TARGETS = (
    "bottle.stopper",
    "bottle.neck",
    "teapot.handle",
    "teapot.lid",
    "wine_glass.bowl",
    "wine_glass.stem",
    "vase.flower",
    "vase.neck",
    "candle.flame",
    "candle.wax",
    "brush.handle",
    "brush.block",
    "clock.rim",
    "clock.bell",
    "bell.knob",
    "bell.handle",
    "globe.pin",
    "globe.stem",
    "basket.handle",
    "basket.post",
)
"""Parts among which is chosen, two of each object."""


@dataclass(frozen=True, kw_only=True)
class AskPart(AskObject):
    """Objects with two parts each, of which exactly one part answers the episode's question."""

    area = "purpose"
    targets = PURPOSE_TARGETS
    shares_places = True
    column_meanings = AskObject.column_meanings | {
        "object_correct": "whether the part reached belongs to the object that answers"
    }
    measures = (
        *AskObject.measures,
        Measure("right_object", "part of the right object", "object_correct"),
    )

    fewest = 2
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
        n, count = state.objects.shape
        errors = [state.measure_object(np.full(n, part)) for part in range(count)]
        return np.argmin(np.tensordot(errors, 1 / state.limits, axes=(1, 0)), axis=0)

    def columns(self, setting: Setting, infos: NamedArrays) -> NamedArrays:
        """Return also whether the part reached belongs to the right object."""
        objects = np.array([object_of(target.name) for target in setting.scene.targets])
        right = objects[infos["reached_object"]] == objects[infos["target"]]
        return super().columns(setting, infos) | {"object_correct": right}
