"""Families: kinds of objects as templates, whose instances differ in shape, size and parts.

``families.toml`` lists the kinds. The instance ``mug-17`` is the same object everywhere: its name
alone decides which parts it has and their sizes, and facts and grasp frame follow from these. It is
grasped at its handle, inclined by 45 degrees, and without one at its top, from above.
"""

import hashlib
import tomllib
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from knowarm.errors import unknown_name
from knowarm.questions import INSTANCE, kind_of
from knowarm.world.objects.target import COLOURS, AttributeCode, Target

_FILE = Path(__file__).with_suffix(".toml")
_TABLE: dict[str, Any] = tomllib.loads(_FILE.read_text(encoding="utf-8"))
_SIZES: dict[str, dict[str, list[float]]] = _TABLE.pop("parts")

KINDS = tuple(_TABLE)
"""Kinds that have a template."""

INSTANCES = 20
"""Instances of each kind that are asked for."""

FAMILIES = tuple(f"{kind}{INSTANCE}{i}" for kind in KINDS for i in range(INSTANCES))
"""Objects among which is chosen."""

_SHAPES = tuple(dict.fromkeys(kind["shape"] for kind in _TABLE.values()))

FAMILY_COLOURS = ("red", "yellow", "green", "cyan", "blue", "purple")

_DARK, _LIGHT = ".15 .15 .16 1", ".93 .93 .9 1"
_INCLINED = "0 -.92387953 0 .38268343"
_FROM_ABOVE = "0 1 0 0"


@cache
def instance(name: str) -> Target:
    """Return the target of an instance's name, such as ``mug-17``."""
    shape = _Shape(name)
    attributes = (shape.kind["shape"], *shape.parts)
    return Target(
        name=name,
        mjcf=_FILE,
        xml=shape.xml(),
        colours={colour: COLOURS[colour] for colour in FAMILY_COLOURS},
        coloured_geoms=tuple(shape.coloured),
        round_grasp="handle" not in shape.parts,
        attributes=attributes,
        code=_code(kind_of(name), attributes),
    )


def facts(name: str) -> dict[str, tuple[str, ...]]:
    """Return what holds for an instance: the values of each relation."""
    shape = _Shape(name)
    found = {relation: tuple(values) for relation, values in shape.kind["facts"].items()}
    return found | {"hasShape": (shape.kind["shape"],), "hasPart": tuple(shape.parts)}


def make(name: str) -> Target | None:
    """Return the target of an instance's name; None for names of other objects."""
    kind = kind_of(name)
    return instance(name) if kind in KINDS and kind != name else None


def _code(kind: str, attributes: tuple[str, ...]) -> AttributeCode:
    """Return the code of an instance: shapes, of which it has one, parts and kinds."""
    values = [1.0 if attribute in attributes else -1.0 for attribute in (*_SHAPES, *_SIZES)]
    kinds = [float(kind == other) for other in KINDS]
    return AttributeCode(
        values=(*values, 0.0, *kinds),
        exclusive=len(_SHAPES),
        attributes=len(_SHAPES) + len(_SIZES),
    )


class _Shape:
    """Draws parts and sizes of an instance and assembles its geoms from the bottom to the top."""

    def __init__(self, name: str) -> None:
        kind, _, number = name.partition(INSTANCE)
        if kind not in _TABLE or not number.isdecimal():
            raise unknown_name("instance of a family", name, FAMILIES)
        self.name, self.kind = name, _TABLE[kind]
        seed = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8])
        self._rng = np.random.default_rng(seed)
        self.parts = [p for p in _SIZES if self._rng.random() < self.kind["parts"].get(p, 0)]
        self.coloured: list[str] = []
        self._lines: list[str] = []
        self._build()

    def xml(self) -> str:
        """Return the MJCF of the instance."""
        body = "\n".join(self._lines)
        return f'<mujoco><worldbody><body name="object">\n{body}\n</body></worldbody></mujoco>'

    def _build(self) -> None:
        shape, radius = self.kind["shape"], self._draw(self.kind["radius"])
        high = radius * self._draw(self.kind["flat"]) * 2 if shape == "round" else 0.0
        high = high or self._draw(self.kind["height"])
        top = low = self._foot() if "foot" in self.parts else 0.0
        top += high
        half = high / 2
        solid = {
            "cylindrical": f'type="cylinder" size="{radius:.4f} {half:.4f}"',
            "round": f'type="ellipsoid" size="{radius:.4f} {radius:.4f} {half:.4f}"',
            "square": f'type="box" size="{radius:.4f} {radius:.4f} {half:.4f}"',
        }[shape]
        self._add("body", f'{solid} pos="0 0 {low + half:.4f}"')
        wide = 0.6 * radius if shape == "round" else radius
        if "spout" in self.parts:
            size = self._part("spout")
            start, end = 0.85 * radius, radius + size["length"]
            line = f"{-start:.4f} 0 {low + 0.4 * high:.4f} {-end:.4f} 0 {low + 0.95 * high:.4f}"
            self._add("spout", f'type="capsule" size="{size["thickness"]:.4f}" fromto="{line}"')
        grasp = self._handle(radius, low, high) if "handle" in self.parts else None
        if "neck" in self.parts:
            size = self._part("neck")
            wide, top = size["radius"], top + size["height"]
            half = size["height"] / 2 + 0.004  # reaches into the body
            at = top - half
            self._add("neck", f'type="cylinder" size="{wide:.4f} {half:.4f}" pos="0 0 {at:.4f}"')
        if "rim" in self.parts:
            size = self._part("rim")
            wide, top = wide + size["overhang"], top + size["height"] / 2
            self._disc("rim", wide, size["height"], top, _LIGHT)
            self._disc("inside", 0.8 * wide, 0.002, top + 0.001, _DARK)
        if "lid" in self.parts:
            size = self._part("lid")
            wide, top = wide + size["overhang"], top + size["height"]
            self._disc("lid", wide, size["height"], top, _DARK)
            knob = size["knob"]
            top += 1.4 * knob
            at = top - knob
            self._lines.append(
                f'<geom name="knob" type="sphere" size="{knob:.4f}" pos="0 0 {at:.4f}" '
                f'rgba="{_DARK}"/>'
            )
        position, turn = grasp or f"0 0 {top - 0.01:.4f}", _INCLINED if grasp else _FROM_ABOVE
        self._lines.append(f'<site name="grasp" pos="{position}" quat="{turn}"/>')

    def _foot(self) -> float:
        """Add disc and stem; return the height at which the body stands."""
        size = self._part("foot")
        thick, high = size["thickness"], size["height"]
        self._add("foot", f'type="cylinder" size="{size["radius"]:.4f} .005" pos="0 0 .005"')
        half = high / 2 + 0.002
        self._add("stem", f'type="cylinder" size="{thick:.4f} {half:.4f}" pos="0 0 {half:.4f}"')
        return high

    def _handle(self, radius: float, low: float, high: float) -> str:
        """Add a loop on the +x side of the body; return the point at which it is grasped."""
        size = self._part("handle")
        half, middle, thick = high * size["size"] / 2, low + high / 2, size["thickness"]
        inner, outer = 0.8 * radius, radius + size["reach"]
        corners = [(inner, half), (outer, half), (outer, -half), (inner, -half)]
        for number, ((x, z), (to_x, to_z)) in enumerate(pairwise(corners)):
            line = f"{x:.4f} 0 {middle + z:.4f} {to_x:.4f} 0 {middle + to_z:.4f}"
            self._add(f"handle_{number}", f'type="capsule" size="{thick:.4f}" fromto="{line}"')
        return f"{outer + thick:.4f} 0 {middle:.4f}"

    def _part(self, part: str) -> dict[str, float]:
        return {name: self._draw(between) for name, between in _SIZES[part].items()}

    def _draw(self, between: list[float]) -> float:
        return float(self._rng.uniform(between[0], between[1]))

    def _add(self, name: str, shape: str) -> None:
        """Add a geom in the object's colour."""
        self.coloured.append(name)
        self._lines.append(f'<geom name="{name}" {shape}/>')

    def _disc(self, name: str, radius: float, height: float, top: float, rgba: str) -> None:
        self._lines.append(
            f'<geom name="{name}" type="cylinder" size="{radius:.4f} {height / 2:.4f}" '
            f'pos="0 0 {top - height / 2:.4f}" rgba="{rgba}"/>'
        )
