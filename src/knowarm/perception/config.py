"""Training config of grounding networks, and the specification that is stored with a network."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress
from typing import Literal

from knowarm.config import check_values
from knowarm.errors import UserError
from knowarm.perception.looks import look_of
from knowarm.questions import ObjectColour
from knowarm.ranges import MOST_INT, within
from knowarm.world.config import EnvConfig, facets_of, questions_of, scene_of

Unclear = Literal["guess", "seen", "stop", "ask"]
"""What an agent does that sees no answer, or several: move to the most likely place ("guess"), do
so if it sees any ("seen"), stay ("stop"), or stay and ask which one is meant ("ask")."""

Facets = tuple[ObjectColour, ...]
"""(object, colour) pairs."""

FRAME = 9
"""Numbers that describe a grasp frame: standardized position, x and z axis."""

DESTINATION_WIDTH = 2
"""Numbers that describe where to put an object: standardized x and y."""

LEVEL = 0.9
"""How often the right object is among the candidates, where nothing else is said."""

RETRAIN = "Take one of a run of this task, or leave perception out to train one."


@dataclass(frozen=True, kw_only=True)
class GroundingConfig:
    """Training of a `GroundingNetwork`; its labels come from the simulator."""

    images: int = 16_000
    """Training images per round: first images of episodes, never the same."""
    batch: int = 128
    """Images per gradient step."""
    learning_rate: float = 2e-3
    """Largest learning rate of Adam; it rises and falls once (one cycle)."""
    rounds: int = 20
    """Number of times that images are drawn and each is trained on once."""
    naming_coef: float = 0.5
    """Weight of a second loss that names each visible object and its colour where it stands."""
    channels: int = 64
    """Features of a place, a multiple of 4. Twice as many recognize unseen kinds of objects better
    and cost 2.4 times as much."""
    shared_rounds: int = 0
    """Rounds that train names and grasp frames alone, whose result all agents with the same robot,
    objects and seed share; ``rounds`` then train how queries are compared with places. 0: the
    ``rounds`` train everything together."""
    seed: int | None = None
    """Seed of the network, so that runs with other seeds share it; None: that of the run."""

    def __post_init__(self) -> None:
        check_values(self)
        if self.shared_rounds == 0:
            within(self, 1, MOST_INT, "rounds", where="GroundingConfig.")
        if self.channels < 4 or self.channels % 4:
            raise UserError(
                f"GroundingConfig.channels is {self.channels}; allowed: 4, 8, 12, ..."
            )


@dataclass(frozen=True, kw_only=True)
class GroundingSpec:
    """What a grounding network was made for."""

    robot: str
    """Name of the robot."""
    image_size: int
    """Width and height of the images [px]."""
    objects: int
    """Number of visible objects."""
    facets: Facets
    """The (object, colour) pairs that it distinguishes, F; one of instances that look alike."""
    config: GroundingConfig
    """How it was trained."""

    @classmethod
    def of(cls, env: EnvConfig, config: GroundingConfig) -> "GroundingSpec":
        """Return the specification of a network for a task."""
        return cls(
            robot=scene_of(env).robot.name,
            image_size=env.image_size,
            objects=env.task.asked.visible,
            facets=_looks(facets_of(env), shown_in(env)),
            config=config,
        )

    def check_fits(self, env: EnvConfig, facets: Sequence[ObjectColour]) -> None:
        """Check that the network was made for a task's robot, images and (object, colour) pairs."""
        compared = (
            ("the robot", self.robot, scene_of(env).robot.name),
            ("an image size of", self.image_size, env.image_size),
            ("a number of visible objects of", self.objects, env.task.asked.visible),
        )
        for what, made, needed in compared:
            if made != needed:
                raise UserError(
                    f"The grounding network was made for {what} {made}, and this task has "
                    f"{needed}. {RETRAIN}"
                )
        known = set(self.facets)
        unknown = [
            f"{colour} {name}" for name, colour in facets if (name, colour) not in known
        ]
        if unknown:
            raise UserError(
                f"The grounding network does not know {', '.join(unknown[:5])}, which this task "
                f"shows. {RETRAIN}"
            )


def seen_width(env: EnvConfig) -> int:
    """Return how many numbers a policy is told of what a network sees in a task."""
    return FRAME + DESTINATION_WIDTH * env.task.skill.tells_facts


def shown_in(env: EnvConfig) -> set[ObjectColour]:
    """Return the facets that a task's episodes show."""
    table = questions_of(env)
    if table is None:
        return set(facets_of(env))
    return set(compress(table.facets, table.shown))


def _looks(facets: Facets, shown: set[ObjectColour]) -> Facets:
    """Return the facets of one object per look, of one that is shown if there is any."""
    shown_names = dict(shown)
    chosen: dict[tuple[str, ...], str] = {}
    for name in sorted(dict(facets), key=lambda name: name not in shown_names):
        chosen.setdefault(look_of(name), name)
    kept = set(chosen.values())
    return tuple(facet for facet in facets if facet[0] in kept)
