"""Looks: by which attributes an encoder tells objects apart that templates make."""

from collections.abc import Sequence

import numpy as np

from knowarm.questions import kind_of
from knowarm.world.objects import made
from knowarm.world.objects.target import AttributeCode


def look_of(name: str) -> tuple[str, ...]:
    """Return the kind and attributes of an object that a template makes; the name of any other."""
    target = made(name)
    return (name,) if target is None else (kind_of(name), *target.attributes)


def attribute_codes(names: Sequence[str]) -> list[AttributeCode] | None:
    """Return the codes of objects; None unless templates make all of them."""
    codes = []
    for name in names:
        target = made(name)
        if target is None or target.code is None:
            return None
        codes.append(target.code)
    return codes


def code_matrix(codes: Sequence[AttributeCode]) -> np.ndarray:
    """Return the values of codes, (objects, columns) float32."""
    return np.array([code.values for code in codes], np.float32)
