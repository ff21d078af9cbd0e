"""Skills: how actions move the arm, what has to be done with an object, and when it is done."""

from knowarm.world.tasks.registry import Registry

SKILLS = Registry(
    "skills",
    "knowarm.world.tasks.skills.skill:Skill",
    {
        "reach": "knowarm.world.tasks.skills.reach:Reach",
        "lift": "knowarm.world.tasks.skills.lift.lift:Lift",
        "place": "knowarm.world.tasks.skills.place.place:Place",
        "sort": "knowarm.world.tasks.skills.sort.sort:Sort",
    },
)
"""Skills by ``kind``. To add one, add an entry."""
