"""What is asked of an episode: the objects that stand there, and which of them is meant."""

from knowarm.world.description import MAKERS
from knowarm.world.tasks.registry import Registry

ASKED = Registry(
    "asked",
    "knowarm.world.tasks.asked.asked:Asking",
    {
        "nothing": "knowarm.world.tasks.asked.nothing:AskNothing",
        "choose": "knowarm.world.tasks.asked.query.query:AskObject",
        "purpose": "knowarm.world.tasks.asked.part.part:AskPart",
        "families": "knowarm.world.tasks.asked.family.family:AskInstance",
    },
)
"""What can be asked, by ``kind``. To add one, add an entry."""

MAKERS.append("knowarm.world.tasks.asked.family.families:make")
