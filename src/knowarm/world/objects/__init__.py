"""Objects that can be targets: shipped ones by name, own ones by the path of their TOML file."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from knowarm.errors import unknown_name
from knowarm.questions import INSTANCE, PART
from knowarm.world.description import SUFFIX, read_description
from knowarm.world.objects.families import KINDS, instance
from knowarm.world.objects.target import Target

TARGETS: dict[str, Target] = {
    file.stem: read_description(file.with_suffix(SUFFIX), Target)
    for file in sorted(Path(__file__).parent.glob("*.xml"))
}
"""Shipped objects by name. To add one, put its MJCF and its TOML file here. The masses are our
choice, as of an empty household thing of the size."""

PARTS: dict[str, Target] = {
    f"{whole.name}{PART}{name}": replace(
        whole, name=f"{whole.name}{PART}{name}", grasp_site=part.site, part_geoms=part.geoms
    )
    for whole in TARGETS.values()
    for name, part in whole.parts.items()
}
"""Parts of these objects by name, ``object.part``, those of an object in sequence."""


def find_targets(names: Sequence[str]) -> tuple[Target, ...]:
    """Return the targets of names or TOML files, in their order."""
    targets, shipped = [], TARGETS | PARTS
    for name in names:
        if name.endswith(SUFFIX):
            targets.append(read_description(Path(name), Target))
        elif name in shipped:
            targets.append(shipped[name])
        elif name.partition(INSTANCE)[0] in KINDS:
            targets.append(instance(name))
        else:
            raise unknown_name("target", name, shipped)
    return tuple(targets)
