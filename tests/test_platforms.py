"""Assumptions about macOS and Windows, simulated here: docs/reference/platforms.md lists them."""

import ast
import ctypes
import os
import re
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest

import knowarm
from knowarm.errors import DataWarning
from knowarm.experiment.run_lock import StopRequest
from knowarm.fence import Fence, _warn_of_no_limits, fenced
from knowarm.learn import checkpoint
from knowarm.learn.parallel.processes import keep_freed_memory
from knowarm.study import worker
from tests.source_tree import ROOT, modules

POSIX_ONLY = re.compile(
    r"os\.(fork|killpg|setsid|nice|getuid|geteuid|sysconf|uname|statvfs|chown|mkfifo"
    r"|sched_\w+|getloadavg)|signal\.(SIGKILL|SIGHUP|SIGALRM|SIGUSR\d|SIGCONT|SIGSTOP|pause)"
)
GUARDED = {
    "cores.py": "hasattr(os, 'sched_getaffinity')",
    "fence.py": "hasattr(os, 'fork')",
    "learn/parallel/fork_server.py": "",  # only a fork server imports it
    "learn/parallel/processes.py": "hasattr(signal, 'SIGHUP')",
}
"""Modules that name what Windows lacks, with the test that precedes it."""


def test_what_windows_lacks_is_used_behind_a_test_only():
    offenders = [
        f"{path}:{node.lineno}: {ast.unparse(node)}"
        for path, tree in modules().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and POSIX_ONLY.fullmatch(ast.unparse(node))
        and not (path in GUARDED and GUARDED[path] in ast.unparse(tree))
    ]
    assert not offenders, "\n".join(offenders)


def test_text_files_name_their_encoding():
    """The default of Windows is not UTF-8."""
    offenders = []
    for path, tree in modules().items():
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call) or not isinstance(
                node.func, ast.Attribute
            ):
                continue
            given = {keyword.arg for keyword in node.keywords}
            words = ast.unparse(node)
            text = node.func.attr in ("read_text", "write_text")
            opened = re.search(r"\.open\((['\"][rwax]+\+?['\"])?\)$", words)
            positional = len(node.args) > (node.func.attr == "write_text")
            if "encoding" not in given and (opened or (text and not positional)):
                offenders.append(f"{path}:{node.lineno}: {words}")
    assert not offenders, "\n".join(offenders)


def test_names_of_files_are_legal_on_every_system():
    """Also: none differ in their case only, which macOS and Windows take for the same."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False
    )
    if listed.returncode:
        pytest.skip("needs a checkout with git")
    paths = listed.stdout.decode().split("\0")[:-1]
    written = [*paths, *knowarm.experiment_names()]
    illegal = (
        r'[<>:"\\|?*\x00-\x1f]|[ .](/|$)|(^|/)(con|prn|aux|nul|com\d|lpt\d)(\.|/|$)'
    )
    assert [path for path in written if re.search(illegal, path, re.IGNORECASE)] == []
    assert len({path.lower() for path in written}) == len(set(written))


def test_a_stop_is_requested_where_no_terminal_sends_a_hangup(monkeypatch):
    monkeypatch.delattr(signal, "SIGHUP")
    with StopRequest() as stop:
        signal.raise_signal(signal.SIGTERM)
        assert stop()


@pytest.mark.parametrize("platform", ["darwin", "win32"])
def test_the_c_library_is_left_alone_where_it_is_not_glibc(monkeypatch, platform):
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setattr(
        ctypes, "CDLL", lambda name: pytest.fail("loaded the C library")
    )
    keep_freed_memory()


def test_where_nothing_can_be_fenced_one_line_says_so(monkeypatch):
    monkeypatch.delattr(os, "fork")
    monkeypatch.setattr(Fence, "is_inside", False)
    _warn_of_no_limits.cache_clear()
    with pytest.warns(DataWarning, match="limits neither time nor memory") as said:
        assert [fenced(sum, [1, 2]), fenced(sum, [3])] == [3, 3]
    assert len(said) == 1
    assert "\n" not in str(said[0].message)
    _warn_of_no_limits.cache_clear()


def test_folders_are_not_opened_where_they_cannot_be(monkeypatch, tmp_path):
    windows = SimpleNamespace(name="nt", open=lambda *_: pytest.fail("opened a folder"))
    monkeypatch.setattr(checkpoint, "os", windows)
    checkpoint._sync(tmp_path)


def test_a_worker_without_its_study_stops_by_its_handler_where_kill_would_end_it(
    monkeypatch,
):
    monkeypatch.setattr(worker, "os", SimpleNamespace(name="nt", getpid=os.getpid))
    with StopRequest() as stop:
        worker._request_stop()
        assert stop()
