import os
import subprocess
import sys
from pathlib import Path

KERNEL = """
import os
from knowarm.compiling import _probe, njit

njit(cache=True)(_probe)()
folder = os.environ["NUMBA_CACHE_DIR"]
print(folder, sum(len(files) for _, _, files in os.walk(folder)))
"""


def test_kernels_are_compiled_where_no_folder_can_be_written_to(tmp_path):
    """As for a user without a home, of a package that belongs to another one."""
    only = {
        "NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator",
        "NUMBA_CACHE_DIR": "",
    }
    done = subprocess.run(
        [sys.executable, "-c", KERNEL],
        env={**os.environ, **only, "TMPDIR": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    folder, files = done.stdout.split()
    assert int(files) > 0
    assert not Path(folder).exists()
    assert "Set NUMBA_CACHE_DIR" in done.stderr
