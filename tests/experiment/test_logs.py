from knowarm.experiment import logs
from knowarm.experiment.logs import TrainingProgress


def test_the_few_early_successes_of_one_update_do_not_stand_for_all(capsys, monkeypatch):
    monkeypatch.setattr(logs, "LINE_S", 0.0)
    with TrainingProgress("run", 1000) as progress:
        progress.metrics({"step": 1, "episodes": 96, "return_mean": -20.0, "success": 0.0})
        progress.metrics({"step": 2, "episodes": 4, "return_mean": 80.0, "success": 1.0})
        progress.metrics({"step": 3, "episodes": 0})
    last = capsys.readouterr().err.splitlines()[-1]
    assert "return -16.0 success 4 %" in last


def test_old_episodes_are_forgotten(capsys, monkeypatch):
    monkeypatch.setattr(logs, "LINE_S", 0.0)
    with TrainingProgress("run", 1000) as progress:
        for step in range(1, 40):
            value = -100.0 if step < 20 else 50.0
            row = {"step": step, "episodes": 100, "return_mean": value, "success": 0.0}
            progress.metrics(row)
    assert "return 50.0" in capsys.readouterr().err.splitlines()[-1]


def test_an_evaluation_is_a_line_of_its_own(capsys):
    with TrainingProgress("run", 1000) as progress:
        progress.evaluation(50, {"return_mean": -3.25, "success": 0.5}, True)
    assert capsys.readouterr().err == (
        "run: evaluation at 50: return -3.2, success 50 %, best so far\n"
    )
