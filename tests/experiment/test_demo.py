import dataclasses
import shutil
from functools import partial

import pytest

from knowarm.errors import UserError
from knowarm.experiment import demo as module
from knowarm.experiment.agents import AGENTS
from knowarm.experiment.demo import demo, demo_experiments
from knowarm.experiment.names import experiment_config
from knowarm.report import write_report
from tests.tiny import SHORT


@pytest.mark.slow
def test_the_demo_trains_evaluates_and_resumes(tmp_path, monkeypatch, no_search):
    monkeypatch.setattr(
        module, "EVALUATION", dataclasses.replace(module.EVALUATION, episodes=4)
    )
    tiny = {name: value for name, value in SHORT.items() if name != "total_steps"}
    monkeypatch.setattr(module, "experiment_config", partial(experiment_config, **tiny))
    stops = iter([False, True])
    assert demo(tmp_path, steps=160, should_stop=lambda: next(stops, True)) is None
    with pytest.raises(UserError, match="holds a demo of 160 steps, got 320"):
        demo(tmp_path, steps=320, should_stop=lambda: False)
    paths = demo(tmp_path, steps=160, should_stop=lambda: False)
    assert paths is not None
    evaluated = []
    monkeypatch.setattr(
        "knowarm.experiment.evaluate.evaluate", lambda *a, **o: evaluated.append(a)
    )
    trained = shutil.copytree(tmp_path, tmp_path.parent / "trained")
    stopped = demo(trained, steps=160, should_stop=lambda: len(evaluated) > 0)
    assert (stopped, len(evaluated)) == (None, 2)
    roles = [AGENTS[config.agent].role for config in demo_experiments(160)]
    assert roles == ["baseline", "knowledge"]
    assert [len(list(path.glob("evaluation/*/summary.json"))) for path in paths] == [
        2,
        2,
    ]
    page = write_report(paths, tmp_path / "report.html").read_text()
    assert all(config.name in page for config in demo_experiments(160))
