"""Parts of objects, each with a grasp frame of its own: targets named ``object.part``.

``parts.toml`` lists them: the site of the grasp frame in the object's MJCF file, the width between
the fingers that the part needs, and the geoms that are the part; or why a part is left out.
"""

import tomllib
from dataclasses import replace
from pathlib import Path

from knowarm.questions import PART
from knowarm.world.objects import TARGETS, Target

_TABLE = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))

PARTS: dict[str, Target] = {
    f"{name}{PART}{part}": replace(
        TARGETS[name],
        name=f"{name}{PART}{part}",
        grasp_site=values["site"],
        part_geoms=tuple(values["geoms"]),
    )
    for name, parts in _TABLE.items()
    for part, values in parts.items()
    if "left_out" not in values
}
"""Parts by name, those of an object in sequence. To add one, add a site to the object's file and an
entry to ``parts.toml``."""
