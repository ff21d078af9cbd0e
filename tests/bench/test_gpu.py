"""``bench gpu`` on the CPU device, with tiny sizes: what is measured, kept, refused and added."""

import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from knowarm.bench import gpu, gpu_measure
from knowarm.bench.gpu import bench_gpu
from knowarm.bench.gpu_clock import PartClock, seconds_per_call
from knowarm.bench.gpu_config import GpuBenchConfig
from knowarm.bench.gpu_measure import first_sentence, measure_row, shares_of_ceilings
from knowarm.bench.gpu_rows import memory_row
from knowarm.bench.gpu_training import add_training, training_seconds
from knowarm.cli.bench import print_gpu
from knowarm.errors import UserError
from knowarm.experiment.run_folder import CsvLog, RunFolder

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
        assert result[name] == max(row[name] for row in result["rows"]) > 1
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
        assert 0.7 < sum(shares) <= 1.01
        assert row["step_ms"] * row["env_steps_per_s"] == pytest.approx(1000 * row["num_envs"])
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
    def refuse(*arguments: Any) -> None:
        raise error

    monkeypatch.setattr(gpu_measure, "TorchReachVectorEnv", refuse)
    row = measure_row(TINY, 9, CEILINGS, CPU)
    assert row["num_envs"] == 9
    assert row["error"].startswith(words)
    assert "Use fewer" not in row["error"]
    assert "env_steps_per_s" not in row


def test_other_errors_are_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: Any) -> None:
        raise RuntimeError("an illegal instruction was encountered")

    monkeypatch.setattr(gpu_measure, "TorchReachVectorEnv", fail)
    with pytest.raises(RuntimeError, match="illegal"):
        measure_row(TINY, 9, CEILINGS, CPU)


def test_a_table_with_and_without_figures_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    memory = {"torch_peak_bytes": 2**30, "device_used_bytes": 3 * 2**30}
    rows = [
        {"num_envs": 256, "error": None, "env_steps_per_s": 4321.0} | memory,
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


def test_a_result_that_was_cut_short_is_gone_on_with(measured: list[int]) -> None:
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
    with pytest.raises(UserError, match=r"another config \(epochs: 2 \| 5\)"):
        bench_gpu(replace(TINY, epochs=5), before=before)
    with pytest.raises(UserError, match=r"another machine \(gpu: .*card"):
        bench_gpu(TINY, before=before | {"machine": before["machine"] | {"gpu": "a card"}})


def test_nothing_measured_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco_warp")
    row = {"num_envs": 2, "error": "The memory is full."}
    monkeypatch.setattr(gpu, "measure_row", lambda *arguments: row)
    with pytest.raises(UserError, match=r"Nothing could be measured\. The memory is full\."):
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


def test_a_call_is_timed_over_many_calls() -> None:
    calls: list[int] = []

    def run() -> None:
        calls.append(1)
        time.sleep(0.001)

    assert 0.001 <= seconds_per_call(run, 0.02, CPU) < 0.01
    assert len(calls) >= 10


def test_parts_are_added_up_by_name() -> None:
    clock = PartClock(CPU)
    wait = clock.timed("wait", time.sleep)
    wait(0.002)
    wait(0.003)
    assert clock.timed("other", lambda a, b=0: a + b)(1, b=2) == 3
    seconds = clock.seconds()
    assert seconds["wait"] >= 0.005
    assert set(seconds) == {"wait", "other"}


def test_on_a_gpu_events_stand_around_each_call(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]

    class Event:
        """A CUDA event whose clock stands still between calls [ms]."""

        def __init__(self, enable_timing: bool) -> None:
            assert enable_timing

        def record(self) -> None:
            self.at = now[0]

        def elapsed_time(self, end: "Event") -> float:
            return end.at - self.at

    def work(milliseconds: float) -> None:
        now[0] += milliseconds

    monkeypatch.setattr(torch.cuda, "Event", Event)
    monkeypatch.setattr(torch.cuda, "synchronize", lambda device: None)
    clock = PartClock(torch.device("cuda", 0))
    physics, images = clock.timed("physics", work), clock.timed("images", work)
    clock.timed("whole", lambda: [physics(4), images(2), work(1), physics(3)])()
    assert clock.seconds() == {"physics": 0.007, "images": 0.002, "whole": 0.01}
    images(5)
    assert clock.seconds()["images"] == 0.007


def test_memory_of_a_gpu_is_torchs_and_everybodys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda device: (30, 100))
    monkeypatch.setattr(torch.cuda, "max_memory_allocated", lambda device: 25)
    found = memory_row(torch.device("cuda", 0))
    assert found == {"torch_peak_bytes": 25, "device_used_bytes": 70}


def make_run(path: Path, total: int, steps: list[int], success: list[float]) -> RunFolder:
    folder = RunFolder.create(path)
    config = {"format": 1, "name": "irb120-full-ppo", "total_steps": total, "algorithm": {}}
    folder.write_json("config.json", config)
    for step in steps:
        CsvLog(folder.metrics_path, keep_to_step=10**9).write({"step": step, "wall_time_s": 1})
    for step, share in zip(steps, success, strict=False):
        CsvLog(folder.evaluations_path, keep_to_step=10**9).write({"step": step, "success": share})
    return folder


def test_a_whole_run_gives_its_minutes(tmp_path: Path) -> None:
    folder = make_run(tmp_path / "run", 70_000_000, [100, 70_000_100], [0.5, 0.85])
    result = add_training({"env_steps_per_s": 1.0}, folder, 420.0)
    assert result["env_steps_per_s"] == 1.0
    assert result["training_minutes_70m"] == 7.0
    training = result["training"]
    assert training["finished"]
    assert training["steps_per_s"] == pytest.approx(70_000_100 / 420)
    assert (training["evaluations"], training["best_success"]) == (2, 0.85)
    assert training["step_at_80"] == 70_000_100


@pytest.mark.parametrize(("total", "finished"), [(70_000_000, False), (200, True)])
def test_part_of_a_run_gives_none(total: int, finished: bool, tmp_path: Path) -> None:
    result = add_training({}, make_run(tmp_path / "run", total, [200], []), 60.0)
    assert result["training_minutes_70m"] is None
    assert result["training"]["finished"] is finished
    assert result["training"]["best_success"] is result["training"]["step_at_80"] is None


def test_a_run_without_a_step_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="has not trained yet"):
        add_training({}, make_run(tmp_path / "run", 10, [], []), 1.0)


def test_times_of_commands_are_added(tmp_path: Path) -> None:
    times = tmp_path / "times"
    times.write_text("100.5 160.5\n1000 1007.25\n")
    assert training_seconds(times) == 67.25
    for text in ("", "1\n", "a b\n"):
        times.write_text(text)
        with pytest.raises(UserError, match="times"):
            training_seconds(times)
    with pytest.raises(UserError, match="Cannot read"):
        training_seconds(tmp_path / "none")
