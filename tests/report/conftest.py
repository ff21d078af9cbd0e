"""A report over two tasks, made once for all tests that only read it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from knowarm.report import write_report
from tests.report.synthetic_study import (
    LABEL,
    Size,
    Truth,
    env_of,
    write_evaluation,
    write_study,
)
from tests.thorough import without_forks


@dataclass(frozen=True)
class Made:
    """A report and what it was made from."""

    page: Path
    runs: list[Path]


@pytest.fixture(scope="session")
def made(tmp_path_factory) -> Made:
    folder = tmp_path_factory.mktemp("a folder with spaces")
    size = Size(points=20, episodes=60, films=3, steps=True, blind=True)
    truth = Truth(
        success={
            "bm": 0.5,
            "partial": 0.55,
            "full": 0.8,
            "wide": 0.5,
            "zeros": 0.5,
            "random": 0.5,
        }
    )
    runs = write_study(folder / "runs", truth, seeds=3, size=size)
    pair = Truth(success={"bm": 0.4, "full": 0.5})
    runs += write_study(
        folder / "runs", pair, seeds=1, robot="tiago", colours="randomized", size=size
    )
    for path in runs:
        if path.name != "0":
            continue
        tiago = path.parent.name.startswith("tiago")
        env = env_of("tiago", "randomized") if tiago else env_of()
        generator = np.random.default_rng(0)
        write_evaluation(
            path / "evaluation" / f"{LABEL}-untrained", "x", 0.02, env, generator, size
        )
        many = Size(episodes=300, evaluation={"seeds": 30})
        write_evaluation(
            path / "evaluation" / "anova", path.parent.name, 0.5, env, generator, many
        )
    with without_forks():
        return Made(write_report(runs, folder / "report.html"), runs)
