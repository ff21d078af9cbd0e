"""``knowarm bench``: this machine goes in; speeds as ratios, measured in one run, come out."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from knowarm.bench.learn import BenchConfig, bench_learn
from knowarm.bench.world import WorldBenchConfig, bench_world
from knowarm.cli.tables import check_json_path, print_table, write_json_table


@dataclass(frozen=True, kw_only=True)
class Learn:
    """Measure training speed: our PPO and A3C against sb3-contrib's RecurrentPPO."""

    config: Annotated[BenchConfig, tyro.conf.OmitArgPrefixes] = field(default_factory=BenchConfig)
    """What is measured, and for how long."""
    json: Path | None = None
    """Also write the table to this JSON file."""

    def run(self) -> None:
        """Measure and print."""
        check_json_path(self.json)
        result = bench_learn(self.config)
        hidden = {"what", "parameters", "parameters_ours"}  # for the JSON
        found = dict.fromkeys(name for row in result["rows"] for name in row)
        names = [name for name in found if name not in hidden]
        print_table(
            f"Training {result['experiment']}, {result['cores']} threads or processes each",
            names,
            [[row.get(name) for name in names] for row in result["rows"]],
        )
        for name in ("ratio_vs_sb3", "ratio_vs_sb3_opengl", "ratio_a3c_batched"):
            if result[name] is not None:
                print(f"{name}: {result[name]:.2f}")
        write_json_table(self.json, result)


WORLD_TABLES = {
    "rows": "Environment steps with a picture, all threads or processes together",
    "raycaster": "The ray caster alone",
    "growth": "How ours grows",
}
"""Tables of ``bench world``: field of the JSON, and its title."""


@dataclass(frozen=True, kw_only=True)
class World:
    """Measure simulation with pictures: ours against Gymnasium with OpenGL and MuJoCo Warp."""

    config: Annotated[WorldBenchConfig, tyro.conf.OmitArgPrefixes] = field(
        default_factory=WorldBenchConfig
    )
    """What is measured, and for how long."""
    json: Path | None = None
    """Also write the tables to this JSON file."""

    def run(self) -> None:
        """Measure and print."""
        check_json_path(self.json)
        result = bench_world(self.config)
        for name, title in WORLD_TABLES.items():
            # Figures of CPU time are for the JSON: with the others they fill no terminal.
            rows = [{k: v for k, v in row.items() if "cpu" not in k} for row in result[name]]
            if rows:
                print_table(title, list(rows[0]), [list(row.values()) for row in rows])
        write_json_table(self.json, result)


COMMANDS: dict[str, type] = {"world": World, "learn": Learn}
"""The commands of the group, by name."""
