import sys

import pytest

from knowarm.errors import UserError
from knowarm.experiment.run import run_path, train
from knowarm.study.config import write_study
from knowarm.study.driver import run_study
from knowarm.study.mirrors import MIRRORS, open_mirror
from knowarm.study.worker import work
from tests.study.tiny import tiny


def stop_and_resume(tmp_path, name: str) -> None:
    """Train half of a run with a mirror, then the rest."""
    study = tiny(seeds=(0,), evaluations=())
    config = study.runs()[0]
    folder = run_path(tmp_path, config)
    for resume in (False, True):
        asked = []
        mirror = open_mirror(name, config, folder, study.name)

        def stop(resume=resume, asked=asked) -> bool:
            asked.append(0)
            return not resume and len(asked) > 2

        train(config, tmp_path, resume=resume, should_stop=stop, mirrors=[mirror])


def test_mlflow_continues_the_run(tmp_path, monkeypatch):
    mlflow = pytest.importorskip("mlflow")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", (tmp_path / "mlflow").as_uri())
    monkeypatch.setenv("MLFLOW_ALLOW_FILE_STORE", "true")
    stop_and_resume(tmp_path, "mlflow")
    client = mlflow.MlflowClient()
    experiment = client.get_experiment_by_name("tiny")
    (run,) = client.search_runs([experiment.experiment_id])
    assert run.data.tags["experiment"] == "irb120-bm-ppo"
    history = client.get_metric_history(run.info.run_id, "train/entropy")
    assert [each.step for each in history] == [20, 40, 60, 80]
    assert len(client.get_metric_history(run.info.run_id, "evaluation/success")) == 3


def test_wandb_continues_the_run_offline(tmp_path, monkeypatch):
    pytest.importorskip("wandb")
    monkeypatch.setenv("WANDB_MODE", "offline")
    stop_and_resume(tmp_path, "wandb")
    files = sorted((tmp_path / "irb120-bm-ppo" / "0" / "wandb").glob("offline-run-*/*.wandb"))
    assert len(files) == 2  # `wandb sync` joins the two sessions of one run
    assert len({file.name for file in files}) == 1


def test_a_mirror_that_fails_does_not_fail_the_run(tmp_path, monkeypatch, capsys, inline):
    def fail(*arguments):
        raise OSError("no network")

    monkeypatch.setitem(MIRRORS, "wandb", fail)
    study = tiny(seeds=(0,), mirrors=("wandb",))
    write_study(study, tmp_path)
    work(tmp_path, ("irb120-bm-ppo", 0))
    assert "'wandb' failed and is switched off: no network" in capsys.readouterr().err
    assert (tmp_path / "irb120-bm-ppo" / "0" / "evaluation").is_dir()


def test_an_unknown_or_missing_service_is_named(tmp_path, monkeypatch):
    with pytest.raises(UserError, match=r"Unknown mirror 'wanbd'.*'wandb'"):
        tiny(mirrors=("wanbd",))
    monkeypatch.setitem(sys.modules, "wandb", None)
    with pytest.raises(UserError, match=r"pip install 'knowarm\[tracking\]'"):
        run_study(tiny(mirrors=("wandb",)), tmp_path)
