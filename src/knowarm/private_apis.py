"""Private APIs of other libraries: every use in KnowArm, with its reason.

tests/test_private_apis.py fails where a new version of a library lacks one of them.
"""

import torch


def cpu_has_bfloat16() -> bool:
    """Tell whether the CPU multiplies bfloat16 matrices in hardware (AVX512-BF16 or AMX).

    PyTorch has no public function for it: ``torch.backends.cpu.get_cpu_capability`` names the
    vector instructions and leaves out both extensions.
    """
    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())
