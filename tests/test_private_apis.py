"""Private functions of other libraries exist and return what `knowarm.private_apis` expects."""

import torch

from knowarm import private_apis


def test_the_cpu_reports_whether_it_has_bfloat16_products():
    assert isinstance(torch.cpu._is_avx512_bf16_supported(), bool)
    assert isinstance(torch.cpu._is_amx_tile_supported(), bool)
    assert isinstance(private_apis.cpu_has_bfloat16(), bool)


def test_either_extension_is_enough(monkeypatch):
    for vectors, tiles in ((False, False), (True, False), (False, True)):
        monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda answer=vectors: answer)
        monkeypatch.setattr(torch.cpu, "_is_amx_tile_supported", lambda answer=tiles: answer)
        assert private_apis.cpu_has_bfloat16() == (vectors or tiles)
