"""Colours and places to keep for a test go in; which draws an episode may take comes out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from knowarm.errors import UserError, unknown_name
from knowarm.world.arrays import Array, array_namespace

TRIES = 32
"""Places drawn for an episode; the first allowed one is taken. At most half of the rectangle is
held out, so all of them miss once in 2**32 episodes."""


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """Colours and places that training never shows, to test generalization on them later.

    Train with ``play="rest"``, evaluate with ``play="held_out"`` and the same other fields.
    """

    colours: tuple[str, ...] = ()
    """Names of held-out colours; a target keeps at least one of its own on either side."""

    places: tuple[float, float, float, float] | None = None
    """Held-out part of the rectangle, x from, x to, y from, y to, in -1..1 across it."""

    play: Literal["rest", "held_out"] = "rest"
    """Which side this environment plays."""

    def __post_init__(self) -> None:
        if self.play not in ("rest", "held_out"):
            raise UserError(f"HeldOut.play must be rest or held_out, got {self.play!r}.")
        if not self.colours and self.places is None:
            raise UserError("HeldOut needs colours or places to hold out; give one, or leave it.")
        if self.places is not None:
            x0, x1, y0, y1 = self.places
            share = (x1 - x0) * (y1 - y0) / 4
            inside = -1 <= x0 < x1 <= 1 and -1 <= y0 < y1 <= 1
            if not inside or not 0.01 <= share <= 0.5:
                raise UserError(
                    "HeldOut.places must be x from < x to, y from < y to within -1 to 1 and 1 to "
                    f"50 % of the rectangle, got {self.places} ({100 * share:.0f} %)."
                )


def allowed_colours(held_out: HeldOut | None, colours: Sequence[str], target: str) -> list[int]:
    """Indices of the colours of a target that may be drawn.

    Raises:
        UserError: none is left.
    """
    if held_out is None or not held_out.colours:
        return list(range(len(colours)))
    wanted = held_out.play == "held_out"
    allowed = [i for i, name in enumerate(colours) if (name in held_out.colours) == wanted]
    # A target none of whose colours is held out plays with all of them on both sides.
    if not any(name in held_out.colours for name in colours):
        return list(range(len(colours)))
    if not allowed:
        raise UserError(
            f"HeldOut.colours {held_out.colours} leave target {target!r} no colour to play "
            f"{held_out.play!r} with; it has {', '.join(colours)}. Hold out fewer, or use "
            "colours='randomized'."
        )
    return allowed


def check_names(held_out: HeldOut | None, names: Sequence[str]) -> None:
    """Refuse held-out colours that no target has.

    Raises:
        UserError: an unknown colour; the nearest names are in the message.
    """
    for name in held_out.colours if held_out else ():
        if name not in names:
            raise unknown_name("held-out colour", name, names)


def choose_places(held_out: HeldOut | None, signed: Array) -> Array:
    """Take the first place of each episode that is on the side to be played.

    Args:
        held_out: the places held out; None allows all.
        signed: candidates in -1..1, (n, T, 2) float64, NumPy or torch.

    Returns:
        (n, 2), uniform on that side.
    """
    if held_out is None or held_out.places is None:
        return signed[:, 0]
    xp = array_namespace(signed)
    x0, x1, y0, y1 = held_out.places
    if held_out.play == "held_out":
        x, y = (signed[:, 0, 0] + 1) / 2, (signed[:, 0, 1] + 1) / 2
        return xp.stack([x0 + x * (x1 - x0), y0 + y * (y1 - y0)], axis=-1)
    x, y = signed[..., 0], signed[..., 1]
    outside = (x < x0) | (x > x1) | (y < y0) | (y > y1)
    first = xp.argmax(xp.astype(outside, xp.uint8), axis=1)
    return signed[xp.arange(signed.shape[0], device=signed.device), first]
