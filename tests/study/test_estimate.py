import pytest

import knowarm.study.estimate
from knowarm.cli.main import main
from knowarm.errors import UserError
from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.experiment.probes import BlindProbe
from knowarm.study.estimate import estimate
from knowarm.study.executor import Where
from tests.study.tiny import TOML, tiny
from tests.tiny import STUDY


@pytest.fixture
def measured(monkeypatch):
    """The configs that were measured; all take 100 steps/s."""
    configs = []

    def measure(config, cores):
        configs.append(config)
        return 100.0

    monkeypatch.setattr(knowarm.study.estimate, "measure", measure)
    return configs


def test_training_is_measured_and_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(knowarm.study.estimate, "SECONDS", 0.1)
    found = estimate(tiny(where=Where(at_once=1)), tmp_path / "out")
    assert (len(found.statuses), found.slots, found.steps) == (2, 1, 2 * 40)
    assert found.steps_per_s > 0
    assert not (tmp_path / "out").exists()


def test_steps_of_training_and_evaluations_are_added_up(tmp_path, measured, finished):
    done = estimate(tiny(), finished)
    assert (done.statuses, done.core_hours, measured) == ([], 0, [])
    evaluations = (
        EvaluationConfig(episodes=10, probes=()),
        EvaluationConfig(label="b", episodes=10, probes=(BlindProbe(episodes=20),)),
    )
    study = tiny(evaluations=evaluations, where=Where(at_once=2, cores=1))
    found = estimate(study, tmp_path / "out")
    assert [config.seed for config in measured] == [0, 0]  # one experiment, in both slots
    # Open-loop, blind and frozen agents play the ten episodes, too.
    assert found.evaluation_steps == 2 * (10 + 4 * 10) * 50
    assert found.core_hours == pytest.approx((2 * 40 + found.evaluation_steps) / 100 / 3600)
    assert found.hours == pytest.approx(found.core_hours / 2)


def test_a_dry_run_lists_the_runs(tmp_path, measured, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(TOML)
    assert main(["study", "run", "mine.toml", "--dry-run", "--at-once", "1"]) == 0
    out = capsys.readouterr().out
    assert [word for word in out.split() if word[:1].isalnum()].count("irb120-bm-ppo") == 1
    assert "80 steps of training" in out
    assert "Nothing was started." in out
    assert [path.name for path in tmp_path.iterdir()] == ["mine.toml"]
    monkeypatch.setenv("FORCE_COLOR", "1")  # as on a terminal: a clock shows that it measures
    main(["study", "run", "mine.toml", "--dry-run", "--at-once", "1"])
    assert "0:00:0" in capsys.readouterr().err


def test_an_experiment_that_cannot_be_trained_is_named(tmp_path):
    algorithm = {**STUDY["algorithm"], "device": "cuda", "processes": None}
    study = tiny(overrides={**STUDY, "algorithm": algorithm}, where=Where(at_once=1))
    with pytest.raises(UserError, match=r"irb120-bm-ppo cannot be trained: .*cuda"):
        estimate(study, tmp_path)
