"""Private APIs of other libraries still do what ``knowarm.private_apis`` relies on."""

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import torch
from numba import njit

from knowarm import private_apis
from knowarm.private_apis import key_numba_cache

OPTIMIZERS = """
import sys
import torch
from knowarm.learn.optimizer import Adam, Muon

def trained(kind):
    matrix = torch.arange(6.0).reshape(2, 3).requires_grad_()
    optimizer = kind([matrix], lr=0.1)
    for scale in (1, -2, 3):
        optimizer.zero_grad()
        (scale * matrix.square()).sum().backward()
        optimizer.step()
    optimizer.load_state_dict(optimizer.state_dict())
    return matrix.detach()

matrices = trained(Adam), trained(Muon)
assert "torch._dynamo" not in sys.modules
for matrix, kind in zip(matrices, (torch.optim.Adam, torch.optim.Muon)):
    assert torch.equal(matrix, trained(kind)), kind
assert "torch._dynamo" in sys.modules
"""


def load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_optimizers_do_not_import_the_compiler() -> None:
    subprocess.run([sys.executable, "-c", OPTIMIZERS], check=True)


def test_numba_caches_a_function_under_its_key(tmp_path: Path) -> None:
    path = tmp_path / "cached_function.py"
    path.write_text("def double(x):\n    return 2 * x\n")

    alive = []  # Numba cannot import the module again, so its functions must stay

    def cache_hits(key: str) -> int:
        compiled = njit(cache=True)(key_numba_cache(load(path).double, key))
        alive.append(compiled)
        assert compiled(4) == 8
        return sum(compiled.stats.cache_hits.values())

    assert [cache_hits(key) for key in ("a", "a", "b", "b", "a")] == [0, 1, 0, 1, 1]


def test_keyed_function_keeps_its_name_and_docstring() -> None:
    keyed = key_numba_cache(load, "key")
    assert (keyed.__name__, keyed.__doc__) == (load.__name__, load.__doc__)


def test_the_cpu_reports_whether_it_has_bfloat16_products():
    assert isinstance(torch.cpu._is_avx512_bf16_supported(), bool)
    assert isinstance(torch.cpu._is_amx_tile_supported(), bool)
    assert isinstance(private_apis.cpu_has_bfloat16(), bool)


def test_either_extension_is_enough(monkeypatch):
    for vectors, tiles in ((False, False), (True, False), (False, True)):
        monkeypatch.setattr(
            torch.cpu, "_is_avx512_bf16_supported", lambda answer=vectors: answer
        )
        monkeypatch.setattr(
            torch.cpu, "_is_amx_tile_supported", lambda answer=tiles: answer
        )
        assert private_apis.cpu_has_bfloat16() == (vectors or tiles)


ENDING = """
import atexit, threading, time
from concurrent.futures import ThreadPoolExecutor
from knowarm.private_apis import end_process

atexit.register(print, "registered")
pool = ThreadPoolExecutor(2)
pool.submit(time.sleep, 0).result()
threading.Thread(target=lambda: (time.sleep(0.2), print("thread"))).start()
end_process(3)
"""


def test_a_process_ends_with_a_pool_of_threads_after_its_other_threads():
    done = subprocess.run(
        [sys.executable, "-c", ENDING], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (3, "")
    assert done.stdout.split() == ["thread", "registered"]
