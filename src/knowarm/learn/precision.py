"""A wish for a precision goes in; the one this machine's processor is fast at comes out."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

import torch

from knowarm.errors import UserError
from knowarm.policy.policy import MatmulPrecision

Wish = Literal["auto"] | MatmulPrecision


def has_fast_bfloat16() -> bool:
    """Tell whether the processor multiplies bfloat16 in hardware (AVX512-BF16 or AMX)."""
    return torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()


def resolve_precision(wish: Wish, device: torch.device) -> MatmulPrecision:
    """Return the wish, or for ``auto`` bfloat16 where the device has it, else float32.

    Raises:
        UserError: "tf32", which only GPUs have, on a processor.
    """
    on_gpu = device.type == "cuda"
    if wish == "tf32" and not on_gpu:
        raise UserError(
            "precision 'tf32' is a GPU's; on the CPU choose 'auto', 'float32' or 'bfloat16'."
        )
    if wish != "auto":
        return wish
    fast = torch.cuda.is_bf16_supported() if on_gpu else has_fast_bfloat16()
    return "bfloat16" if fast else "float32"


@contextmanager
def products(precision: MatmulPrecision, device: torch.device) -> Iterator[None]:
    """Have a GPU's float32 products rounded to TF32 if that is the precision, and only then."""
    if device.type != "cuda":
        yield
        return
    matmul, cudnn = torch.backends.cuda.matmul, torch.backends.cudnn
    before = matmul.allow_tf32, cudnn.allow_tf32
    matmul.allow_tf32 = cudnn.allow_tf32 = precision == "tf32"
    try:
        yield
    finally:
        matmul.allow_tf32, cudnn.allow_tf32 = before
