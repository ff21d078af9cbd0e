"""Families: kinds of objects as templates, whose instances differ in shape, size and parts.

``families.toml`` lists the kinds. The instance ``mug-17`` is the same object everywhere: its name
alone decides which parts it has and their sizes, and facts and grasp frame follow from these. It is
grasped at its handle, inclined by 45 degrees, and without one at its top, from above.
"""

import hashlib
import tomllib
from collections.abc import Callable
from functools import cache
from itertools import pairwise, product
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

FAMILIES = tuple(f"{kind}{INSTANCE}{i}" for kind, i in product(KINDS, range(INSTANCES)))
"""Objects among which is chosen."""

_SHAPES = tuple(dict.fromkeys(kind["shape"] for kind in _TABLE.values()))
_GEOMS = {"cylindrical": "cylinder", "round": "ellipsoid", "square": "box"}

FAMILY_COLOURS = ("red", "yellow", "green", "cyan", "blue", "purple")

Lengths = tuple[float, ...]

_DARK = ".15 .15 .16 1"
_LIGHT = ".93 .93 .9 1"
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
    values = {
        relation: tuple(listed) for relation, listed in shape.kind["facts"].items()
    }
    values["hasShape"] = (shape.kind["shape"],)
    values["hasPart"] = tuple(shape.parts)
    return values


def make(name: str) -> Target | None:
    """Return the target of an instance's name; None for names of other objects."""
    kind = kind_of(name)
    if kind == name or kind not in KINDS:
        return None
    return instance(name)


def _code(kind: str, attributes: tuple[str, ...]) -> AttributeCode:
    """Return the code of an instance: shapes, of which it has one, parts and kinds."""
    names = (*_SHAPES, *_SIZES)
    values = [1.0 if name in attributes else -1.0 for name in names]
    kinds = [float(kind == other) for other in KINDS]
    return AttributeCode(
        values=(*values, 0.0, *kinds),
        exclusive=len(_SHAPES),
        attributes=len(names),
    )


class _Shape:
    """Draws parts and sizes of an instance and assembles its geoms from the bottom to the top."""

    def __init__(self, name: str) -> None:
        kind, _, number = name.partition(INSTANCE)
        if kind not in _TABLE or not number.isdecimal():
            raise unknown_name("instance of a family", name, FAMILIES)
        self.kind = _TABLE[kind]
        seed = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8])
        self._rng = np.random.default_rng(seed)
        shares = self.kind["parts"]
        self.parts = [
            part for part in _SIZES if self._rng.random() < shares.get(part, 0)
        ]
        self.coloured: list[str] = []
        self._lines: list[str] = []
        is_round = self.kind["shape"] == "round"
        self._radius = self._draw(self.kind["radius"])
        if is_round:
            self._height = self._radius * self._draw(self.kind["flat"]) * 2
        else:
            self._height = self._draw(self.kind["height"])
        self._low = 0.0  # Height of the lower end of the body
        if "foot" in self.parts:
            self._add_foot(**self._sizes("foot"))
        # Upper end of what is assembled, and its radius
        self._top = self._low + self._height
        self._wide = 0.6 * self._radius if is_round else self._radius
        self._add_body()
        self._handle = ""
        upwards: dict[str, Callable[..., None]] = {
            "spout": self._add_spout,
            "handle": self._add_handle,
            "neck": self._add_neck,
            "rim": self._add_rim,
            "lid": self._add_lid,
        }
        for part, add in upwards.items():
            if part in self.parts:
                add(**self._sizes(part))
        grasp = _metres(0, 0, self._top - 0.01)
        turn = _FROM_ABOVE
        if self._handle:
            grasp = self._handle
            turn = _INCLINED
        self._lines.append(f'<site name="grasp" pos="{grasp}" quat="{turn}"/>')

    def xml(self) -> str:
        """Return the MJCF of the instance."""
        body = "\n".join(self._lines)
        return f'<mujoco><worldbody><body name="object">\n{body}\n</body></worldbody></mujoco>'

    def _add_foot(self, radius: float, height: float, thickness: float) -> None:
        """Add disc and stem, on which the body stands."""
        self._add(
            name="foot", type="cylinder", size=f"{_metres(radius)} .005", pos="0 0 .005"
        )
        half = height / 2 + 0.002
        self._add_upright("stem", "cylinder", (thickness, half), half)
        self._low = height

    def _add_body(self) -> None:
        shape = self.kind["shape"]
        half = self._height / 2
        size: Lengths = (self._radius, self._radius, half)
        if shape == "cylindrical":
            size = (self._radius, half)
        self._add_upright("body", _GEOMS[shape], size, self._low + half)

    def _add_spout(self, length: float, thickness: float) -> None:
        start = (-0.85 * self._radius, 0, self._low + 0.4 * self._height)
        end = (-(self._radius + length), 0, self._low + 0.95 * self._height)
        self._add_rod("spout", thickness, start, end)

    def _add_handle(self, reach: float, thickness: float, size: float) -> None:
        """Add a loop on the +x side of the body, at which it is grasped."""
        half = self._height * size / 2
        middle = self._low + self._height / 2
        inner = 0.8 * self._radius
        outer = self._radius + reach
        low = middle - half
        high = middle + half
        corners = [(inner, 0, high), (outer, 0, high), (outer, 0, low), (inner, 0, low)]
        for number, (start, end) in enumerate(pairwise(corners)):
            self._add_rod(f"handle_{number}", thickness, start, end)
        self._handle = _metres(outer + thickness, 0, middle)

    def _add_neck(self, radius: float, height: float) -> None:
        self._wide = radius
        self._top += height
        half = height / 2 + 0.004  # reaches into the body
        self._add_upright("neck", "cylinder", (radius, half), self._top - half)

    def _add_rim(self, overhang: float, height: float) -> None:
        self._wide += overhang
        self._top += height / 2
        self._add_disc("rim", self._wide, height, self._top, _LIGHT)
        self._add_disc("inside", 0.8 * self._wide, 0.002, self._top + 0.001, _DARK)

    def _add_lid(self, overhang: float, height: float, knob: float) -> None:
        self._wide += overhang
        self._top += height
        self._add_disc("lid", self._wide, height, self._top, _DARK)
        self._top += 1.4 * knob
        self._add_upright("knob", "sphere", (knob,), self._top - knob, rgba=_DARK)

    def _add_disc(
        self, name: str, radius: float, height: float, top: float, rgba: str
    ) -> None:
        half = height / 2
        self._add_upright(name, "cylinder", (radius, half), top - half, rgba=rgba)

    def _add_upright(
        self, name: str, shape: str, size: Lengths, middle: float, **colour: str
    ) -> None:
        """Add a geom around the axis of the object, with its middle at a height."""
        pos = _metres(0, 0, middle)
        self._add(name=name, type=shape, size=_metres(*size), pos=pos, **colour)

    def _add_rod(
        self, name: str, thickness: float, start: Lengths, end: Lengths
    ) -> None:
        """Add a capsule between two points."""
        fromto = _metres(*start, *end)
        self._add(name=name, type="capsule", size=_metres(thickness), fromto=fromto)

    def _add(self, **attributes: str) -> None:
        """Add a geom, in the object's colour unless it has one of its own."""
        if "rgba" not in attributes:
            self.coloured.append(attributes["name"])
        text = " ".join(f'{name}="{value}"' for name, value in attributes.items())
        self._lines.append(f"<geom {text}/>")

    def _sizes(self, part: str) -> dict[str, float]:
        return {name: self._draw(between) for name, between in _SIZES[part].items()}

    def _draw(self, between: list[float]) -> float:
        low, high = between
        return self._rng.uniform(low, high)


def _metres(*lengths: float) -> str:
    """Write lengths [m] as MJCF does, with four decimals; a whole 0 stays one."""
    return " ".join(f"{length:.4f}" if length else "0" for length in lengths)
