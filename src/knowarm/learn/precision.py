"""A wish for a precision goes in; the one this machine's processor is fast at comes out."""

from typing import Literal

import torch

from knowarm.policy.policy import Precision


def has_fast_bfloat16() -> bool:
    """Tell whether the processor multiplies bfloat16 in hardware (AVX512-BF16 or AMX)."""
    return torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()


def resolve_precision(wish: Literal["auto"] | Precision) -> Precision:
    """Return the wish, or for ``auto`` bfloat16 where the processor has it, else float32."""
    if wish != "auto":
        return wish
    return "bfloat16" if has_fast_bfloat16() else "float32"
