"""Objects that can be targets: shipped ones by name, own ones by the path of their TOML file."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from knowarm.errors import UserError, unknown_name
from knowarm.own import load
from knowarm.questions import PART
from knowarm.world.description import MAKERS, SUFFIX, read_description
from knowarm.world.objects.target import Target, refuse_model

TARGETS: dict[str, Target] = {
    file.stem: read_description(file.with_suffix(SUFFIX), Target)
    for file in sorted(Path(__file__).parent.glob("*.xml"))
}
"""Shipped objects by name. To add one, put its MJCF and its TOML file here. The masses are our
choice, as of an empty household thing of the size."""


def _parts() -> dict[str, Target]:
    parts = {}
    for whole in TARGETS.values():
        for part_name, part in whole.parts.items():
            name = f"{whole.name}{PART}{part_name}"
            parts[name] = replace(
                whole, name=name, grasp_site=part.site, part_geoms=part.geoms
            )
    return parts


PARTS = _parts()
"""Parts of these objects by name, ``object.part``, those of an object in sequence."""


def find_targets(names: Sequence[str]) -> tuple[Target, ...]:
    """Return the targets of names or TOML files, in their order."""
    shipped = TARGETS | PARTS
    targets = []
    for name in names:
        if name.endswith(SUFFIX):
            targets.append(read_description(Path(name), Target))
            continue
        refuse_model("A target", Path(name))
        target = shipped.get(name) or made(name)
        if target is None and name.endswith((".xml", ".mjcf")):
            raise UserError(
                f"A target is named by its TOML file, got {name!r}. Give "
                f"{str(Path(name).with_suffix(SUFFIX))!r}, with the field mjcf = "
                f"{json.dumps(Path(name).name)}."
            )
        if target is None:
            raise unknown_name("target", name, shipped)
        targets.append(target)
    return tuple(targets)


def made(name: str) -> Target | None:
    """Return an object that has no file, but is made by its name, such as "mug-17"; else None."""
    for import_path in MAKERS:
        make = load(import_path, "maker of targets", callable, "a function of a name")
        target: Target | None = make(name)
        if target is not None:
            return target
    return None
