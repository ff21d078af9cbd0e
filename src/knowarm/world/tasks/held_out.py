"""Held-out colours and positions: training never shows them, evaluation tests them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from knowarm.arrays import Floats
from knowarm.errors import UserError, unknown_name

TRIES = 32
"""Positions drawn per episode, of which the first allowed one is used. At most half of the
rectangle is held out, so all of them fail in one of 2**32 episodes."""


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """Colours and positions that training never shows, to test generalization to them.

    Train with ``play="rest"``, evaluate with ``play="held_out"`` and the same other fields.
    """

    colours: tuple[str, ...] = ()
    """Names of held-out colours. Every target needs a colour among them and one outside, or none of
    its colours among them."""
    places: tuple[float, float, float, float] | None = None
    """Held-out part of the rectangle, as x from, x to, y from and y to in -1..1."""
    play: Literal["rest", "held_out"] = "rest"
    """Whether this environment shows the held-out part or the rest."""

    def __post_init__(self) -> None:
        if self.places is not None:
            x0, x1, y0, y1 = self.places
            share = (x1 - x0) * (y1 - y0) / 4
            is_inside = -1 <= x0 < x1 <= 1 and -1 <= y0 < y1 <= 1
            if not is_inside or not 0.01 <= share <= 0.5:
                raise UserError(
                    "HeldOut.places must be x from < x to, y from < y to within -1 to 1 and 1 to "
                    f"50 % of the rectangle, got {self.places} ({100 * share:.0f} %)."
                )
        elif not self.colours:
            raise UserError(
                "HeldOut needs colours or places to hold out: give one, or pass held_out=None."
            )


def allowed_colours(
    held_out: HeldOut | None, colours: Sequence[str], target: str
) -> list[int]:
    """Return the indices of the colours in which a target may be shown."""
    every = list(range(len(colours)))
    if held_out is None:
        return every
    reserved = [i for i in every if colours[i] in held_out.colours]
    # A target without a held-out colour shows all of its colours on both sides.
    if not reserved:
        return every
    if held_out.play == "held_out":
        return reserved
    allowed = [i for i in every if i not in reserved]
    if not allowed:
        raise UserError(
            f"HeldOut.colours {held_out.colours} leave target {target!r} no colour for "
            f"play={held_out.play!r}; its colours are {', '.join(colours)}. Hold out fewer, or use "
            "randomized colours."
        )
    return allowed


def check_names(held_out: HeldOut | None, names: Sequence[str]) -> None:
    """Check that the held-out colours are among those of all targets."""
    if held_out is None:
        return
    for name in held_out.colours:
        if name not in names:
            raise unknown_name("held-out colour", name, names)


def choose_places(held_out: HeldOut | None, signed: Floats) -> Floats:
    """Select each episode's first allowed position of candidates (n, T, 2) in -1..1, (n, 2)."""
    if held_out is None or held_out.places is None:
        return signed[:, 0]
    low = np.array(held_out.places[::2])
    high = np.array(held_out.places[1::2])
    if held_out.play == "held_out":
        return low + (signed[:, 0] + 1) / 2 * (high - low)
    is_outside = ((signed < low) | (signed > high)).any(axis=-1)
    return signed[np.arange(len(signed)), is_outside.argmax(axis=1)]
