"""Nothing goes in; the shape that every estimate with its uncertainty has comes out."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Interval:
    """An estimate and the ends of its confidence interval.

    Attributes:
        estimate: the value itself.
        low: lower end; equal to ``estimate`` where one observation allows no interval.
        high: upper end.
        confidence: coverage the interval was made for, in 0..1.
    """

    estimate: float
    low: float
    high: float
    confidence: float = 0.95

    @property
    def excludes_zero(self) -> bool:
        """Whether zero lies outside the interval."""
        return self.low > 0 or self.high < 0

    def scaled(self, factor: float) -> "Interval":
        """The same interval in another unit; ``factor`` is positive."""
        assert factor > 0
        return Interval(
            self.estimate * factor, self.low * factor, self.high * factor, self.confidence
        )
