import json
import os
import shutil
import signal
import time
from pathlib import Path

import psutil
import pytest

from knowarm.errors import UserError
from knowarm.experiment.run import train
from knowarm.experiment.run_folder import RunFolder
from knowarm.experiment.run_lock import lock_folder
from knowarm.reading import read_json
from knowarm.study import driver, executor
from knowarm.study.config import OverridesFor, write_study
from knowarm.study.driver import request_stop, retry, run_study
from knowarm.study.executor import LocalExecutor, Where
from knowarm.study.status import FAILURE, is_trained, study_status, totals
from knowarm.study.worker import STOP
from tests.study.tiny import InlineExecutor, tiny
from tests.tiny import STUDY

NONE_AGAIN = Where(retries=0)
"""Runs whose worker dies are not started again: how runs start needs no training."""


@pytest.fixture
def executors(monkeypatch):
    """Executors that were made, in order; the first one lets as many workers die as it says."""
    made = []

    def make(where, out):
        made.append(InlineExecutor(where, out, deaths=make.deaths))
        return made[-1]

    make.deaths = 0
    monkeypatch.setattr(driver, "make_executor", make)
    monkeypatch.setattr(driver, "POLL_S", 0.0)
    monkeypatch.setattr(driver, "STATUS_S", 0.0)
    made.append(make)
    yield made
    made.clear()


def states(study, out):
    return [each.state for each in study_status(study, out)]


def test_a_study_trains_and_evaluates_every_run_once(tmp_path, executors):
    study = tiny()
    seen = []
    done = run_study(
        study, tmp_path, on_status=lambda all: seen.append([a.state for a in all])
    )
    assert seen[0] == ["waiting", "waiting"]
    assert [each.state for each in done] == ["done", "done"]
    assert [each.step for each in done] == [40, 40]
    assert totals(done, 1)["core_hours_left"] == 0
    assert totals(done, 1)["core_hours"] > 0
    before = (tmp_path / "irb120-bm-ppo" / "0" / "config.json").stat().st_mtime_ns
    run_study(study, tmp_path)
    assert executors[-1].started == []
    assert (
        tmp_path / "irb120-bm-ppo" / "0" / "config.json"
    ).stat().st_mtime_ns == before


def test_a_stopped_run_goes_on_and_missing_evaluations_are_made(tmp_path, executors):
    study = tiny(seeds=(0,))
    train(study.runs()[0], tmp_path, should_stop=lambda: True)
    assert states(study, tmp_path) == ["stopped"]
    train(study.runs()[0], tmp_path, resume=True)
    assert states(study, tmp_path) == ["trained"]
    run_study(study, tmp_path)
    assert states(study, tmp_path) == ["done"]
    rows = (
        (tmp_path / "irb120-bm-ppo" / "0" / "evaluations.csv").read_text().splitlines()
    )
    assert len(rows) == 4


def test_runs_pause_at_a_step_and_go_on_to_the_same_bytes(
    tmp_path, executors, finished
):
    study = tiny()
    paused = run_study(study, tmp_path, until_step=15)
    assert [each.state for each in paused] == ["paused", "paused"]
    assert [each.step for each in paused] == [20, 20]
    assert [each.best_step for each in paused] == [
        best_step(tmp_path, each) for each in paused
    ]
    started = len(executors[-1].started)
    run_study(study, tmp_path, until_step=15)
    assert len(executors) == 3
    assert executors[-1].started == []
    assert started == 2
    done = run_study(study, tmp_path)
    assert [each.state for each in done] == ["done", "done"]
    for name in ("policy", "optimizer", "state"):
        file = f"irb120-bm-ppo/1/checkpoints/latest/{name}.safetensors"
        assert (tmp_path / file).read_bytes() == (finished / file).read_bytes()
    with pytest.raises(UserError, match="until_step must be at least 1, got 0"):
        run_study(study, tmp_path, until_step=0)


def best_step(out, status):
    """Return the step of the best model that the run itself states."""
    facts = read_json(out / status.name / "checkpoints" / "best" / "meta.json")["facts"]
    assert facts["return_mean"] == pytest.approx(status.best_return)
    return facts["step"]


def test_listed_runs_start_in_their_order(tmp_path, executors):
    names = ("irb120-full-ppo/1", "irb120-bm-ppo", "irb120-full-ppo")
    longer = OverridesFor(experiments="irb120-full-ppo", fields={"total_steps": 100})
    runs = {"seeds": (0,), "experiments": names, "overrides_for": (longer,)}
    executors[0].deaths = 3
    run_study(tiny(order="listed", where=NONE_AGAIN, **runs), tmp_path)
    bm, full = "irb120-bm-ppo", "irb120-full-ppo"
    assert executors[-1].started == [(full, 1), (bm, 0), (full, 0)]


def test_an_error_fails_its_run_only_and_retry_resumes_it(
    tmp_path, executors, monkeypatch
):
    study = tiny()
    broken = {0}

    def train_or_fail(config, *arguments, **options):
        if config.seed in broken:
            raise RuntimeError("no such luck")
        return train(config, *arguments, **options)

    monkeypatch.setattr("knowarm.study.worker.train", train_or_fail)
    first, second = run_study(study, tmp_path)
    assert (first.state, second.state) == ("failed", "done")
    assert first.detail == "RuntimeError: no such luck"
    broken.clear()
    assert run_study(study, tmp_path)[0].state == "failed"
    with pytest.raises(UserError, match=r"'irb120-bm-ppo/0'"):
        retry(tmp_path, ["irb120-bm-ppo/7"])
    assert retry(tmp_path, ["irb120-bm-ppo/1"]) == []
    assert retry(tmp_path) == ["irb120-bm-ppo/0"]
    assert [each.state for each in run_study(study, tmp_path)] == ["done", "done"]


def test_a_killed_worker_is_started_again_a_few_times(tmp_path, executors):
    executors[0].deaths = 3
    study = tiny(seeds=(0,), where=Where(retries=3))
    assert run_study(study, tmp_path / "enough")[0].state == "done"
    study = tiny(seeds=(0,), where=Where(retries=2))
    (status,) = run_study(study, tmp_path / "few")
    assert status.state == "failed"
    assert status.detail.startswith(
        "its process was killed by signal 9, 3 times since step 0"
    )


def test_retry_starts_the_count_of_kills_again(tmp_path):
    study = tiny(seeds=(0,), where=Where(retries=2))
    write_study(study, tmp_path)
    under_way = driver._Driver(study, tmp_path, None, print)
    run = ("irb120-bm-ppo", 0)
    failure = tmp_path / run[0] / "0" / FAILURE

    def kill():
        under_way._take_end(executor.Ended(run, "killed", True), False)
        return failure.exists()

    assert [kill() for _ in range(3)] == [False, False, True]
    assert retry(tmp_path) == ["irb120-bm-ppo/0"]
    assert [kill() for _ in range(3)] == [False, False, True]


def test_a_run_that_another_worker_began_meanwhile_is_resumed(
    tmp_path, executors, monkeypatch
):
    resumed = []

    def begin_elsewhere_first(config, *arguments, **options):
        resumed.append(options["resume"])
        if len(resumed) == 1:
            train(config, *arguments, resume=False, should_stop=lambda: True)
        return train(config, *arguments, **options)

    monkeypatch.setattr("knowarm.study.worker.train", begin_elsewhere_first)
    (status,) = run_study(tiny(seeds=(0,)), tmp_path)
    assert status.state == "done", status.detail
    assert resumed == [False, True]


def test_runs_start_seed_by_seed_and_the_longest_first(tmp_path, executors):
    longer = OverridesFor(experiments="tiago-*", fields={"total_steps": 100})
    names = ("irb120-bm-ppo", "tiago-bm-ppo")
    runs = {"seeds": (3, 0), "experiments": names, "overrides_for": (longer,)}
    executors[0].deaths = 4
    run_study(tiny(where=NONE_AGAIN, **runs), tmp_path)
    assert executors[-1].started == [
        (name, seed) for seed in (3, 0) for name in names[::-1]
    ]


def test_other_studies_and_changed_runs_are_refused(finished):
    for study, words in (
        (tiny(name="other"), "holds the study 'tiny', not 'other'"),
        (
            tiny(overrides={**STUDY, "total_steps": 100}),
            r"bm-ppo/0 has another config.*total_steps: 40 \| 100",
        ),
        (tiny(seeds=(1, 2)), r"no longer belong to the study: irb120-bm-ppo/0 \(1\)"),
    ):
        with pytest.raises(UserError, match=words):
            driver.check_folder(study, finished)
    # More seeds are no other study
    driver.check_folder(tiny(seeds=(0, 1, 2)), finished)


def test_a_silent_run_that_another_process_holds_is_not_waited_for(
    tmp_path, executors, monkeypatch
):
    study, start = tiny(seeds=(0,)), time.monotonic()
    path = train(study.runs()[0], tmp_path, should_stop=lambda: True).folder.path
    monkeypatch.setattr("knowarm.study.status.SILENT_S", -1.0)
    with lock_folder(path, remedy=""):
        ended = run_study(
            study, tmp_path, should_stop=lambda: time.monotonic() - start > 20
        )
    assert [each.state for each in ended] == ["stalled"]
    assert time.monotonic() - start < 20


def test_a_run_with_pending_interim_evaluations_is_not_trained(tmp_path, finished):
    config, _ = tiny().runs()
    path = finished / "irb120-bm-ppo" / "0"
    folder = RunFolder(Path(shutil.copytree(path, tmp_path / "run")))
    assert is_trained(folder, config)
    meta = folder.checkpoints / "latest" / "meta.json"
    assert '"pending": 0' in meta.read_text()
    meta.write_text(meta.read_text().replace('"pending": 0', '"pending": 1'))
    assert not is_trained(folder, config)


@pytest.mark.parametrize(
    ("visible", "gpus"), [("-1", []), ("1,-1,2", ["1"]), ("0,1", ["0", "1"])]
)
def test_gpus_that_the_environment_hides_are_not_used(monkeypatch, visible, gpus):
    monkeypatch.setattr("torch.cuda.device_count", lambda: 0)
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    assert executor._gpus() == gpus


def test_a_folder_in_use_is_refused(tmp_path, executors):
    write_study(tiny(seeds=(0,)), tmp_path)
    assert not request_stop(tmp_path)
    with lock_folder(tmp_path, remedy=""):
        assert request_stop(tmp_path)
        assert (tmp_path / STOP).exists()
        with pytest.raises(UserError, match="is in use"):
            run_study(tiny(seeds=(0,)), tmp_path)


def test_a_stop_request_ends_the_study(tmp_path, executors):
    def stop(statuses):
        (tmp_path / STOP).touch()

    assert [each.state for each in run_study(tiny(), tmp_path, on_status=stop)] == [
        "stopped",
        "waiting",
    ]
    assert [each.state for each in run_study(tiny(), tmp_path)] == ["done", "done"]


@pytest.mark.parametrize(
    "needs", [{"cores": 10_000}, {"memory_gib": 1e6}, {"gpus": 100}]
)
def test_a_machine_that_is_too_small_is_refused(tmp_path, needs):
    with pytest.raises(UserError, match=rf"where\.{next(iter(needs))}"):
        LocalExecutor(Where(**needs), tmp_path)


@pytest.mark.skipif(
    not hasattr(signal, "SIGSTOP"), reason="Windows cannot stop processes"
)
def test_a_stopped_worker_is_killed_after_a_deadline(tmp_path, monkeypatch):
    monkeypatch.setattr(executor, "TIMEOUT_S", 0.5)
    write_study(tiny(), tmp_path)
    local = LocalExecutor(Where(), tmp_path)
    others = set(psutil.Process().children())  # such as the fork server of another test
    local.start(run := ("irb120-bm-ppo", 0))
    (worker,) = set(psutil.Process().children()) - others
    os.kill(worker.pid, signal.SIGSTOP)
    local.stop()
    ended, begin = [], time.monotonic()
    while not ended and time.monotonic() - begin < 20:
        ended = local.ended()
        time.sleep(0.1)
    assert [(each.run, each.killed) for each in ended] == [(run, True)]
    assert not worker.is_running()
    local.close()


def test_a_worker_that_is_stopped_saves_its_run(tmp_path):
    """A real worker: its checkpoints are written by the stop alone."""
    long = STUDY | {"total_steps": 10_000_000, "checkpoint_every_steps": 10_000_000}
    long |= {"interim": {"every_steps": 10_000_000, "episodes": 2}}
    study = tiny(overrides=long, seeds=(0,), where=Where(at_once=1, memory_gib=0.1))
    path = tmp_path / "irb120-bm-ppo" / "0"
    begin = time.monotonic()

    def trains():
        log = path / "metrics.csv"
        trained = log.exists() and log.read_text().count("\n") > 1
        return trained or time.monotonic() - begin > 120

    (stopped,) = run_study(study, tmp_path, should_stop=trains)
    assert stopped.state == "stopped"
    assert stopped.step > 0
    assert not (path / FAILURE).exists()
    assert RunFolder(path).checkpoint_fact("step", 0) > 0, "no checkpoint was saved"
    assert "worked for" in (path / executor.LOG).read_text(), "the worker was killed"


def test_the_reason_of_a_failure_is_in_the_run_folder(tmp_path, executors, monkeypatch):
    monkeypatch.setattr("knowarm.study.worker.train", lambda *a, **o: 1 / 0)
    run_study(tiny(seeds=(0,)), tmp_path)
    record = json.loads((tmp_path / "irb120-bm-ppo" / "0" / FAILURE).read_text())
    assert record["reason"] == "ZeroDivisionError: division by zero"
    assert "Traceback" in record["traceback"]
