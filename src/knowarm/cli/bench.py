"""``knowarm bench``: this machine goes in; speeds as ratios, measured in one run, come out."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from knowarm.bench.gpu import bench_gpu
from knowarm.bench.gpu_config import GpuBenchConfig
from knowarm.bench.gpu_training import add_training, training_seconds
from knowarm.bench.learn import BenchConfig, bench_learn
from knowarm.bench.world import WorldBenchConfig, bench_world
from knowarm.cli.tables import check_json_path, print_table, write_json_table
from knowarm.errors import UserError
from knowarm.experiment.run_folder import RunFolder, read_json, write_json

LEARN_COLUMNS = {
    "name": "",
    "envs": "envs",
    "steps_per_s": "steps/s",
    "share_simulation": "physics",
    "share_image": "images",
    "share_inference": "inference",
    "share_update": "update",
    "staleness_mean": "stale",
}
"""Columns of ``bench learn``'s table: field of a row, and its title; the JSON has more."""


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
        print_table(
            f"Training {result['experiment']}, {result['cores']} threads or processes each",
            list(LEARN_COLUMNS.values()),
            [[row.get(name) for name in LEARN_COLUMNS] for row in result["rows"]],
        )
        print("Shares of the time; the ray caster's steps are frames of one core.")
        for name in ("ratio_vs_sb3", "ratio_vs_sb3_opengl", "ratio_a3c_batched"):
            if result[name] is not None:
                print(f"{name}: {result[name]:.2f}")
        write_json_table(self.json, result)


WORLD_TABLES = {
    "rows": "Environment steps with a image, all threads or processes together",
    "raycaster": "The ray caster alone",
    "growth": "How ours grows",
}
"""Tables of ``bench world``: field of the JSON, and its title."""


@dataclass(frozen=True, kw_only=True)
class World:
    """Measure simulation with images: ours against Gymnasium with OpenGL and MuJoCo Warp."""

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


GPU_LINES = {
    "env_steps_per_s": "environment steps/s, with images",
    "env_share_physics": "  share of physics",
    "env_share_images": "  share of images",
    "env_bandwidth_share": "  reached of the bandwidth",
    "env_operations_share": "  reached of the operations",
    "training_steps_per_s": "training steps/s, end to end",
    "training_share_physics": "  share of physics",
    "training_share_images": "  share of images",
    "training_share_inference": "  share of inference",
    "training_share_update": "  share of the update",
    "training_bandwidth_share": "  reached of the bandwidth",
    "training_operations_share": "  reached of the operations",
    "torch_peak_gib": "memory of torch at most [GiB]",
    "device_used_gib": "memory of the whole device [GiB]",
}
"""Lines of ``bench gpu``'s table: field of a row, and what it is called."""


def print_gpu(result: dict[str, Any]) -> None:
    """Print a result of ``bench_gpu``: the table, what did not fit, ceilings, the whole run."""
    gpu, rows = result["machine"]["gpu"], []
    for row in result["rows"]:
        memory = {name: row[f"{name}_bytes"] for name in ("torch_peak", "device_used")}
        rows.append(row | {f"{k}_gib": None if v is None else v / 2**30 for k, v in memory.items()})
    print_table(
        f"{gpu['name'] if gpu else 'The CPU device'}, by number of environments",
        ["", *(f"{row['num_envs']:,}" for row in rows)],
        [[title, *(row.get(name) for row in rows)] for name, title in GPU_LINES.items()],
    )
    for row in rows:
        if row["error"]:
            print(f"{row['num_envs']:,} environments: {row['error']}")
    ceilings = [f"{k} {v:.3g}" for k, v in result["ceilings"].items() if v is not None]
    print(f"Ceilings: {', '.join(ceilings)}")
    if (training := result["training"]) is not None:
        print(
            f"{training['experiment']}: {training['step']:,} of {training['total_steps']:,} steps "
            f"in {training['minutes']:.2f} minutes, {training['evaluations']} interim evaluations"
        )


@dataclass(frozen=True, kw_only=True)
class Gpu:
    """Measure worlds and training on one GPU beside what the GPU can do at most."""

    config: Annotated[GpuBenchConfig, tyro.conf.OmitArgPrefixes] = field(
        default_factory=GpuBenchConfig
    )
    """What is measured, and for how long."""
    json: Path | None = None
    """Also write the result to this JSON file, after every row."""
    resume: bool = False
    """Go on with the JSON file where it was cut short."""

    def run(self) -> None:
        """Measure and print."""
        if self.resume and self.json is None:
            raise UserError("--resume goes on with a JSON file; give --json.")
        check_json_path(self.json)
        before = None
        if self.resume and self.json is not None and self.json.exists():
            before = read_json(self.json)

        def keep(result: dict[str, Any]) -> None:
            if self.json is not None:
                write_json(self.json, result)

        result = bench_gpu(self.config, keep, before)
        print_gpu(result)
        write_json_table(self.json, result)


@dataclass(frozen=True, kw_only=True)
class GpuTraining:
    """Add a trained run to the result of ``bench gpu``, and print both."""

    folder: tyro.conf.Positional[Path]
    """Folder of the run."""
    json: Path
    """JSON file of ``bench gpu``."""
    times: Path
    """File of lines "begin end", seconds of the clock, one for each command that trained."""

    def run(self) -> None:
        """Add and print."""
        folder = RunFolder.open(self.folder)
        result = add_training(read_json(self.json), folder, training_seconds(self.times))
        write_json(self.json, result)
        print_gpu(result)


COMMANDS: dict[str, type] = {
    "world": World,
    "learn": Learn,
    "gpu": Gpu,
    "gpu-training": GpuTraining,
}
"""The commands of the group, by name."""
