"""Runs of Stable-Baselines3: a callback that writes the run folder of a training."""

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from knowarm.config import to_dict
from knowarm.errors import UserError, packages_of
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.csv_log import CsvLog
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.experiment.interim import interim_evaluation
from knowarm.experiment.provenance import provenance
from knowarm.experiment.run import run_path
from knowarm.experiment.run_folder import RunFolder
from knowarm.reading import write_json
from knowarm.world.agents.protocol import Batch, Observations
from knowarm.world.config import facets_of
from knowarm.world.tasks.state import nearest_levels

with packages_of("sb3", "SB3Run"):
    from stable_baselines3.common.callbacks import BaseCallback


class SB3Run(BaseCallback):
    """Writes the run folder of a training, which reports and figures show beside KnowArm's.

    It plays the interim evaluations of KnowArm's runs, and after the training an evaluation of the
    last model, always by the most probable actions. The agent is named after the model's class.

    Args:
        config: the experiment whose environment and knowledge the model has; its algorithm is the
            one beside which reports show the run.
        runs: parent folder; the run is in ``<runs>/<name>-sb3/<seed>``, with the model as sb3.zip.
        evaluation: the evaluation after the training; None takes the defaults.
    """

    def __init__(
        self,
        config: ExperimentConfig,
        runs: Path | str = "runs",
        evaluation: EvaluationConfig | None = None,
    ) -> None:
        super().__init__()
        self._config = config
        self._runs = Path(runs)
        self._evaluation = evaluation or EvaluationConfig()

    def _on_training_start(self) -> None:
        config = replace(
            self._config,
            name=f"{self._config.name}-sb3",
            agent=f"SB3 {type(self.model).__name__}",
            total_steps=self.locals["total_timesteps"],
        )
        table = config.knows.known(config.env, config.seed).table
        self._player = cast(Any, _Player(self.model, table))
        self._config = config
        self._folder = RunFolder.create(run_path(self._runs, config))
        parameters = sum(weights.numel() for weights in self.model.policy.parameters())
        about = provenance(
            parameter_counts={"total": parameters}, facets=facets_of(config.env)
        )
        write_json(self._folder.provenance_path, to_dict(about))
        self._folder.write_knowledge(table)
        self._folder.write_experiment(config)
        self._log = CsvLog(self._folder.evaluations_path)
        self._play = interim_evaluation(
            config.env, config.interim, lambda policy: self._player
        )
        self._evaluate_now()

    def _on_step(self) -> bool:
        if self.num_timesteps - self._last_step >= self._config.evaluate_every:
            self._evaluate_now()
        return True

    def _on_training_end(self) -> None:
        if self.num_timesteps > self._last_step:
            self._evaluate_now()
        self.model.save(self._folder.path / "sb3.zip")
        name = f"{self._config.name}/{self._config.seed}"
        env = self._config.env
        result = evaluate(self._player, env, self._evaluation, agent_name=name)
        result.write(self._folder.evaluation(result.summary.label))

    def _evaluate_now(self) -> None:
        self._last_step = self.num_timesteps
        policy: Any = self.model.policy
        self._log.write({"step": self.num_timesteps, **self._play(policy)})


class _Player:
    """Plays a model with the knowledge of each episode; KnowArm's environments have no other."""

    def __init__(self, model: Any, table: np.ndarray) -> None:
        self._model = model
        self._table = table
        self._names = getattr(model.observation_space, "spaces", None)
        unknown = set(self._names or ()) - {"image", "knowledge"}
        if unknown:
            raise UserError(
                f"SB3Run evaluates models that observe image and knowledge, and this one also "
                f"observes {', '.join(sorted(unknown))}. Leave that out of observe."
            )

    def reset(self, batch: Batch) -> None:
        """Forget the recurrent state."""
        self._state = None
        self._start = np.ones(batch.size, np.bool_)
        self._knowledge = self._table[batch.rows]

    def act(self, observations: Observations) -> np.ndarray:
        """Predict, and play continuous actions as the nearest levels."""
        inputs: Any = observations["image"]
        if self._names is not None:
            shown = {"image": inputs, "knowledge": self._knowledge}
            inputs = {name: shown[name] for name in self._names}
        actions, self._state = self._model.predict(
            inputs, self._state, self._start, True
        )
        self._start = np.zeros_like(self._start)
        if np.issubdtype(actions.dtype, np.integer):
            return actions
        return nearest_levels(actions)
