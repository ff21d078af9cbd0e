"""Counter of the kernels that torch would launch on a GPU, without a GPU."""

from collections import Counter
from typing import Any

from torch.utils._python_dispatch import TorchDispatchMode

NO_KERNEL = ("empty", "detach", "alias", "_unsafe_view", "lift_fresh", "_local_scalar_dense")
"""Operations that launch nothing, besides views; reading a scalar is a copy of the driver's."""


class LaunchCounter(TorchDispatchMode):
    """Counts operations that launch at least one kernel each, by name, while it is active."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: Counter[str] = Counter()

    @property
    def total(self) -> int:
        """Number of operations."""
        return sum(self.seen.values())

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = str(func).removeprefix("aten.")
        if not func.is_view and not name.startswith(NO_KERNEL):
            self.seen[name] += 1
        return func(*args, **(kwargs or {}))
