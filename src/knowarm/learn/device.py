"""Device support: precision of the matrix products."""

from typing import Literal

import torch

from knowarm.policy import MatmulPrecision
from knowarm.private_apis import cpu_has_bfloat16

PrecisionChoice = Literal["auto"] | MatmulPrecision


def resolve_precision(choice: PrecisionChoice, device: torch.device) -> MatmulPrecision:
    """Return the precision that a choice means on a device.

    "auto" is bfloat16 where the device computes it in hardware, else float32.
    """
    if choice != "auto":
        return choice
    is_fast = cpu_has_bfloat16() if device.type == "cpu" else torch.cuda.is_bf16_supported()
    return "bfloat16" if is_fast else "float32"
