from knowarm.experiment import logs
from knowarm.experiment.csv_log import read_csv
from knowarm.experiment.logs import RunLogs, TrainingProgress
from knowarm.experiment.run_folder import RunFolder


def test_lines_tell_the_success_of_evaluations_and_not_of_easier_training_episodes(
    capsys, monkeypatch
):
    monkeypatch.setattr(logs, "LINE_S", 0.0)
    row = {"step": 1, "episodes": 96, "return_mean": 80.0, "success": 1.0}
    with TrainingProgress("run", 1000) as progress:
        progress.metrics(row)
        assert "success" not in capsys.readouterr().err
        progress.evaluation(1, {"return_mean": -3.25, "success": 0.65}, True)
        progress.metrics(row | {"step": 2})
    assert capsys.readouterr().err.endswith(", success 65 % in the last evaluation\n")


def test_an_evaluation_is_a_line_of_its_own(capsys):
    with TrainingProgress("run", 1000) as progress:
        progress.evaluation(50, {"return_mean": -3.25, "success": 0.5}, True)
    assert capsys.readouterr().err == (
        "run: evaluation at 50: return -3.2, success 50 %, best so far\n"
    )


def test_without_tensorboard_curves_are_in_csv_files_and_one_line_says_so(
    capsys, monkeypatch, tmp_path
):
    monkeypatch.setattr(logs, "find_spec", lambda name: None)
    folder = RunFolder(tmp_path)
    run_logs = RunLogs(folder, TrainingProgress("run", 10))
    run_logs.open(keep_to_step=None)
    for step in (1, 2):
        run_logs.metrics({"step": step, "loss": 0.5})
    run_logs.close()
    assert [row["loss"] for row in read_csv(folder.metrics_path)] == ["0.5", "0.5"]
    assert not folder.tensorboard.exists()
    assert capsys.readouterr().err.count("pip install 'knowarm[tensorboard]'") == 1
