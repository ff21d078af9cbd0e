"""A range of values and a range of pixels go in; the way between them, and its ticks, come out."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Scale:
    """Linear map from values to pixels.

    Attributes:
        low: value at ``start``.
        high: value at ``end``; above ``low``.
        start: first pixel.
        end: last pixel; below ``start`` for an axis that points up.
    """

    low: float
    high: float
    start: float
    end: float

    def __call__(self, value: float) -> float:
        """Pixel of a value."""
        share = (value - self.low) / (self.high - self.low)
        return self.start + share * (self.end - self.start)

    def ticks(self, count: int = 5) -> list[float]:
        """About ``count`` round values inside the range."""
        step = round_step((self.high - self.low) / max(1, count))
        first = math.ceil(self.low / step - 1e-9)
        last = math.floor(self.high / step + 1e-9)
        return [round(i * step, 12) for i in range(first, last + 1)]


def round_step(rough: float) -> float:
    """Whichever of 1, 2, 2.5, 5 times a power of ten is nearest to ``rough``, as a ratio."""
    power = 10.0 ** math.floor(math.log10(rough))
    return min((m * power for m in (1, 2, 2.5, 5, 10)), key=lambda s: abs(math.log(s / rough)))


def fit(values: list[float], start: float, end: float, *, pad: float = 0.06) -> Scale:
    """A scale that holds all values with some room around them."""
    finite = [value for value in values if math.isfinite(value)] or [0.0, 1.0]
    low, high = min(finite), max(finite)
    room = (high - low) * pad or abs(high) * 0.1 or 1.0
    return Scale(low - room, high + room, start, end)
