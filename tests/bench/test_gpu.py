"""Tests of ``bench gpu`` on the CPU device with tiny sizes."""

import json
from dataclasses import replace
from typing import Any

import pytest
import torch

from knowarm.bench import gpu, gpu_measure
from knowarm.bench.gpu import bench_gpu
from knowarm.bench.gpu_measure import (
    GpuBenchConfig,
    first_sentence,
    measure_row,
    memory_row,
    shares_of_ceilings,
)
from knowarm.cli.bench import print_gpu
from knowarm.errors import UserError

CPU = torch.device("cpu")
CEILINGS = {
    "copy_bytes_per_s": 1000.0,
    "float32_operations_per_s": 100.0,
    "tf32_operations_per_s": None,
    "bfloat16_operations_per_s": 200.0,
}
TINY = GpuBenchConfig(
    device="cpu",
    num_envs=(2, 4),
    seconds=0.01,
    image_size=24,
    rollout_steps=4,
    matmul_side=16,
    copy_bytes=1000,
)


def test_everything_is_measured_on_the_cpu_device() -> None:
    pytest.importorskip("mujoco_warp")
    result = bench_gpu(replace(TINY, num_envs=(4,)))
    assert [row["num_envs"] for row in result["rows"]] == [4]
    assert result["machine"]["gpu"] is None
    assert result["machine"]["versions"]["warp-lang"]
    assert result["ceilings"]["tf32_operations_per_s"] is None
    assert result["training_minutes_70m"] is None
    for name in ("env_steps_per_s", "training_steps_per_s"):
        assert result[name] == max(row[name] for row in result["rows"]) > 0
    for row in result["rows"]:
        assert row["error"] is None
        assert row["torch_peak_bytes"] is row["device_used_bytes"] is None
        parts = [row[f"env_share_{part}"] for part in ("physics", "images", "rest")]
        assert all(0 < share < 1 for share in parts)
        assert sum(parts) == pytest.approx(1)
        shares = [
            row[f"training_share_{part}"]
            for part in ("physics", "images", "rest", "inference", "update")
        ]
        assert all(0 < share < 1 for share in shares)
        assert sum(shares) <= 1.01
        assert row["step_ms"] * row["env_steps_per_s"] == pytest.approx(1000 * row["num_envs"])
        assert row["host_ms"] > 0
        for what in ("env", "training"):
            assert row[f"{what}_bytes_per_step"] > 0
            assert row[f"{what}_bandwidth_share"] > 0
            assert row[f"{what}_operations_share"] > 0
        assert row["training_bytes_per_step"] > row["env_bytes_per_step"]
    assert json.loads(json.dumps(result)) == result
    print_gpu(result)


def test_shares_of_ceilings_are_those_counted_by_hand() -> None:
    shares = shares_of_ceilings("env", 2.0, 50.0, [(10.0, "float32"), (60.0, "bfloat16")], CEILINGS)
    # 2 x 50 of 1000 bytes; 2 x (10 / 100 + 60 / 200) of every second
    assert shares == {
        "env_bandwidth_share": pytest.approx(0.1),
        "env_operations_share": pytest.approx(0.8),
    }


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (UserError("9 environments need 1.5 GiB: 3 fit. Use fewer."), "9 environments need 1.5 Gi"),
        (torch.OutOfMemoryError("CUDA out of memory. Tried"), "CUDA out of memory."),
        (RuntimeError("Failed to allocate 5 bytes on device 'cuda:0'"), "Failed to allocate 5"),
    ],
)
def test_environments_that_do_not_fit_are_a_row(
    error: Exception, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*arguments: Any, **options: Any) -> None:
        raise error

    monkeypatch.setattr(gpu_measure, "TorchReachVectorEnv", refuse)
    row = measure_row(TINY, 9, CEILINGS, CPU)
    assert row["num_envs"] == 9
    assert row["error"].startswith(words)
    assert "Use fewer" not in row["error"]
    assert "env_steps_per_s" not in row


def test_other_errors_are_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: Any, **options: Any) -> None:
        raise RuntimeError("an illegal instruction was encountered")

    monkeypatch.setattr(gpu_measure, "TorchReachVectorEnv", fail)
    with pytest.raises(RuntimeError, match="illegal"):
        measure_row(TINY, 9, CEILINGS, CPU)


def test_a_table_with_and_without_figures_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    memory = {"torch_peak_bytes": 2**30, "device_used_bytes": 3 * 2**30}
    rows = [
        {"num_envs": 256, "error": None, "env_steps_per_s": 4321.0, "host_ms": 0.31} | memory,
        {"num_envs": 16384, "error": "They do not fit."} | memory,
    ]
    training = {
        "experiment": "irb120-full-ppo",
        "step": 70_000_000,
        "total_steps": 70_000_000,
        "minutes": 7.5,
        "evaluations": 9,
    }
    print_gpu(
        {
            "machine": {"gpu": {"name": "A card"}},
            "rows": rows,
            "ceilings": CEILINGS,
            "training": training,
        }
    )
    printed = capsys.readouterr().out
    assert "A card, by number of environments" in printed
    assert "4,321" in printed
    assert "0.31" in next(line for line in printed.splitlines() if "the host's part" in line)
    assert "16,384 environments: They do not fit." in printed
    assert "tf32" not in printed
    assert "70,000,000 of 70,000,000 steps in 7.50 minutes" in printed


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of environments that were measured, by a measuring that takes no time."""
    pytest.importorskip("mujoco_warp")
    asked: list[int] = []

    def measure(config: Any, num_envs: int, *others: Any) -> dict[str, Any]:
        asked.append(num_envs)
        return {"num_envs": num_envs, "error": None, "env_steps_per_s": 10.0 * num_envs}

    monkeypatch.setattr(gpu, "measure_row", measure)
    return asked


def test_an_interrupted_result_is_continued(measured: list[int]) -> None:
    partial: dict[str, Any] = {}

    def cut(result: dict[str, Any]) -> None:
        partial.update(json.loads(json.dumps(result)))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        bench_gpu(TINY, cut)
    ceilings = partial["ceilings"]
    partial |= {"training_minutes_70m": 7.0, "training": {"step": 1}}
    result = bench_gpu(TINY, before=partial)
    assert measured == [2, 4]
    assert [row["num_envs"] for row in result["rows"]] == [2, 4]
    assert result["env_steps_per_s"] == 40.0
    assert result["training_steps_per_s"] is None
    assert result["ceilings"] == ceilings
    assert result["training_minutes_70m"] == 7.0


def test_what_did_not_fit_is_tried_again(measured: list[int]) -> None:
    before = bench_gpu(TINY)
    before["rows"][0] = {"num_envs": 2, "error": "Something else used the memory."}
    bench_gpu(TINY, before=before)
    assert measured == [2, 4, 2]


def test_a_result_of_something_else_is_refused(measured: list[int]) -> None:
    before = bench_gpu(TINY)
    with pytest.raises(UserError, match=r"another config .*epochs: 2 \| 5"):
        bench_gpu(replace(TINY, epochs=5), before=before)
    with pytest.raises(UserError, match=r"another machine .*gpu: a card"):
        bench_gpu(TINY, before=before | {"machine": before["machine"] | {"gpu": "a card"}})


def test_nothing_measured_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco_warp")
    row = {"num_envs": 2, "error": "The memory is full."}
    monkeypatch.setattr(gpu, "measure_row", lambda *arguments: row)
    with pytest.raises(UserError, match=r"No row could be measured\. The memory is full\."):
        bench_gpu(TINY)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_a_missing_gpu_is_named_before_anything_starts() -> None:
    pytest.importorskip("mujoco_warp")
    with pytest.raises(UserError, match="device 'cuda'"):
        bench_gpu(GpuBenchConfig())


@pytest.mark.parametrize(
    ("field", "value"), [("seconds", 0.0), ("num_envs", ()), ("num_envs", (4, 0)), ("epochs", 0)]
)
def test_sizes_out_of_range_are_refused(field: str, value: Any) -> None:
    with pytest.raises(UserError, match=field):
        GpuBenchConfig(**{field: value})


def test_first_sentences() -> None:
    assert first_sentence("It needs 1.5 GiB. Use less.") == "It needs 1.5 GiB."
    assert first_sentence("One line\nand another. End.") == "One line"
    assert first_sentence("") == "no message"


def test_memory_of_a_gpu_is_torchs_and_everybodys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda device: (30, 100))
    monkeypatch.setattr(torch.cuda, "max_memory_allocated", lambda device: 25)
    found = memory_row(torch.device("cuda", 0))
    assert found == {"torch_peak_bytes": 25, "device_used_bytes": 70}
