"""``knowarm evaluate``: a run or a scripted agent goes in; a table of its episodes comes out."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from knowarm.cli.tables import check_json_path, print_table, write_json_table
from knowarm.errors import UserError, unknown_name
from knowarm.experiment.evaluate import EvaluationConfig, evaluate
from knowarm.experiment.build import Which, load_agent
from knowarm.world.agents import SCRIPTED_AGENTS, AgentProtocol
from knowarm.world.config import EnvConfig


@dataclass(frozen=True, kw_only=True)
class Evaluate:
    """Play the paper's post-training evaluation and print its table."""

    agent: tyro.conf.Positional[str]
    """A run folder (runs/irb120-full-ppo/0), or a scripted agent: zero, random or oracle."""
    evaluation: Annotated[EvaluationConfig, tyro.conf.OmitArgPrefixes] = field(
        default_factory=EvaluationConfig
    )
    """How the agent is judged."""
    which: Which = "best"
    """Which policy of the run: of the best interim evaluation, the latest, or untrained."""
    env: EnvConfig = field(default_factory=EnvConfig)
    """The task of a scripted agent; a run brings its own."""
    save: bool = True
    """Keep the evaluation in the run folder, where reports find it."""
    json: Path | None = None
    """Also write the table to this JSON file."""

    def run(self) -> None:
        """Play, print, and keep."""
        check_json_path(self.json)
        name, agent, env, out = self._agent()
        result = evaluate(agent, env, self.evaluation, agent_name=name)
        _print(result.summary)
        if out is not None and self.save:
            result.write(out)
            print(f"Kept in {out}")
        write_json_table(self.json, result.summary)

    def _agent(self) -> tuple[str, AgentProtocol, EnvConfig, Path | None]:
        """Name, agent, its world, and where its evaluation is kept."""
        if self.agent in SCRIPTED_AGENTS:
            return (
                self.agent,
                SCRIPTED_AGENTS[self.agent].make(self.evaluation.seed),
                self.env,
                None,
            )
        if "/" not in self.agent and not Path(self.agent).exists():
            raise unknown_name("agent or run folder", self.agent, SCRIPTED_AGENTS)
        if self.env != EnvConfig():
            raise UserError(
                "A run is evaluated in the world it was trained in: leave the env options out."
            )
        trained = load_agent(
            self.agent,
            which=self.which,
            greedy=self.evaluation.actions == "greedy",
            seed=self.evaluation.seed,
        )
        label = self.evaluation.folder + ("" if self.which == "best" else f"-{self.which}")
        name = f"{trained.config.name}/{trained.config.seed}"
        return name, trained.agent, trained.config.env, trained.folder.evaluation(label)


def _print(summary: dict[str, Any]) -> None:
    """Print the table of all episodes and each target, and one of facets where colours vary."""
    title = f"{summary['agent']}: {summary['label']}"
    _print_groups(title, {"all": summary, **summary["per_target"]})
    if len(summary["per_facet"]) > len(summary["per_target"]):
        _print_groups("By target and colour", summary["per_facet"])
    judged = summary["config"]
    print(
        f"accuracy: distance <= {judged['distance_m']} m; success: also angle <= "
        f"{judged['angle_deg']} deg; success wide: <= {judged['wide_angle_deg']} deg.\n"
        "[95 % Wilson intervals]; mean ± standard deviation."
    )


def _print_groups(title: str, groups: dict[str, dict[str, Any]]) -> None:
    """Print numbers as columns and groups of episodes as rows."""
    rows = []
    for name, group in groups.items():
        shares = [_share(group, share) for share in ("accuracy", "success", "success_wide")]
        spreads = [_spread(group, *what) for what in (("return", 1), ("length", 1))]
        failure = _spread(group, "failure_distance", 3)
        rows.append([name, group["episodes"], *shares, *spreads, failure])
    print_table(
        title,
        ["", "n", "accuracy %", "success %", "success wide %", "return", "length", "failure m"],
        rows,
    )


def _share(group: dict[str, Any], name: str) -> str:
    share, low, high = (100 * group[key] for key in (name, f"{name}_low", f"{name}_high"))
    return f"{share:.1f} [{low:.0f}, {high:.0f}]"


def _spread(group: dict[str, Any], name: str, digits: int) -> str:
    mean, deviation = group[f"{name}_mean"], group[f"{name}_std"]
    return "-" if mean is None else f"{mean:.{digits}f} ± {deviation:.{digits}f}"


COMMAND = Evaluate
