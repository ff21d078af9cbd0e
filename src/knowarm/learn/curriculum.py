"""Threshold curriculum: success thresholds that decrease to the task's as training succeeds."""

from typing import Any

from knowarm.errors import UserError
from knowarm.learn.algorithms import ScheduleConfig


class ThresholdCurriculum:
    """Sets the ``threshold_factor`` of an environment: the factor of its success thresholds."""

    def __init__(self, config: ScheduleConfig, env: Any) -> None:
        self._config = config
        self._env = env
        if config.threshold_factor > 1:
            if not hasattr(env, "threshold_factor"):
                raise UserError(
                    f"{type(env).__name__} has no threshold_factor, and the config's is "
                    f"{config.threshold_factor}: leave it at 1, or give the environment an "
                    "attribute of this name that multiplies its success thresholds."
                )
            self.factor = config.threshold_factor

    @property
    def is_used(self) -> bool:
        """Whether training starts with larger thresholds."""
        return self._config.threshold_factor > 1

    @property
    def factor(self) -> float:
        """Factor of the thresholds of distance and angle."""
        return self._env.threshold_factor if self.is_used else 1.0

    @factor.setter
    def factor(self, factor: float) -> None:
        self._env.threshold_factor = factor

    def update(self, success: float) -> None:
        """Decrease the factor if enough of an update's episodes succeeded (0..1)."""
        if self.is_used and success > self._config.threshold_success:
            self.factor = max(1.0, self.factor - self._config.threshold_decrease)
