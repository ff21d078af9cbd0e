"""``knowarm bench``: benchmarks of this machine's simulation, training and GPU."""

from dataclasses import dataclass, field
from typing import Annotated, Any

import tyro

from knowarm.bench.gpu import bench_gpu
from knowarm.bench.gpu_measure import GpuBenchConfig
from knowarm.bench.learn import LearnBenchConfig, bench_learn
from knowarm.bench.study import StudyBenchConfig, bench_study
from knowarm.bench.world import WorldBenchConfig, bench_world
from knowarm.cli.tables import FilePath, check_json_path, print_table, write_json_table
from knowarm.errors import UserError
from knowarm.experiment.run_folder import write_json
from knowarm.reading import read_json

WORLD_TABLES = {
    "rows": "Environment steps/s with images, all threads together",
    "raycaster": "Ray caster alone",
    "scaling": "Scaling with the number of environments and the image size",
}
"""Titles of the tables of ``bench world``, by field of the JSON."""


@dataclass(frozen=True, kw_only=True)
class World:
    """Measure simulation with images on the CPU."""

    config: Annotated[WorldBenchConfig, tyro.conf.OmitArgPrefixes] = field(
        default_factory=WorldBenchConfig
    )
    """Settings of the benchmark."""
    json: FilePath = None
    """Also write the tables to this JSON file."""

    def run(self) -> None:
        """Measure and print."""
        check_json_path(self.json)
        result = bench_world(self.config)
        for name, title in WORLD_TABLES.items():
            if rows := result[name]:
                print_table(title, list(rows[0]), [list(row.values()) for row in rows])
        write_json_table(self.json, result)


LEARN_COLUMNS = {
    "name": "learner",
    "envs": "envs",
    "steps_per_s": "steps/s",
    "share_simulation": "physics",
    "share_images": "images",
    "share_inference": "inference",
    "share_update": "update",
    "staleness_mean": "staleness",
}
"""Column titles of the table of ``bench learn``, by field of a row; the JSON has more fields."""


@dataclass(frozen=True, kw_only=True)
class Learn:
    """Measure training on the CPU: PPO and A3C."""

    config: Annotated[LearnBenchConfig, tyro.conf.OmitArgPrefixes] = field(
        default_factory=LearnBenchConfig
    )
    """Settings of the benchmark."""
    json: FilePath = None
    """Also write the table to this JSON file."""

    def run(self) -> None:
        """Measure and print."""
        check_json_path(self.json)
        result = bench_learn(self.config)
        print_learn(result)
        write_json_table(self.json, result)


def print_learn(result: dict[str, Any]) -> None:
    """Print a result of ``bench_learn``: the table and the ratios."""
    print_table(
        f"Training {result['experiment']}, {result['cores']} threads or processes each",
        list(LEARN_COLUMNS.values()),
        [[row.get(name) for name in LEARN_COLUMNS] for row in result["rows"]],
    )
    if result["success"]:
        print_table(
            "Until 80 % of 100 interim episodes succeed",
            ["name", "what", "steps", "seconds", "best success", "at most"],
            [list(row.values()) for row in result["success"]],
        )
    print("physics, images, inference, update: shares of the time.")
    print("staleness: mean number of other workers' updates since a worker read the parameters.")
    print("raycaster: frames/s of one core, without training.")
    for name, value in result.items():
        if name.startswith("ratio_") and value is not None:
            print(f"{name}: {value:.2f}")


GPU_LINES = {
    "env_steps_per_s": "environment steps/s, with images",
    "step_ms": "  time of a step [ms]",
    "host_ms": "  the host's part of it [ms]",
    "env_share_physics": "  share of physics",
    "env_share_images": "  share of images",
    "env_bandwidth_share": "  share of peak bandwidth",
    "env_operations_share": "  share of peak operations",
    "training_steps_per_s": "training steps/s, end to end",
    "training_share_physics": "  share of physics",
    "training_share_images": "  share of images",
    "training_share_inference": "  share of inference",
    "training_share_update": "  share of updates",
    "training_bandwidth_share": "  share of peak bandwidth",
    "training_operations_share": "  share of peak operations",
    "torch_peak_gib": "peak memory of torch [GiB]",
    "device_used_gib": "memory in use on the device [GiB]",
}
"""Line titles of the table of ``bench gpu``, by field of a row."""


@dataclass(frozen=True, kw_only=True)
class Gpu:
    """Measure simulation and training on one GPU, with its peak rates for comparison."""

    config: Annotated[GpuBenchConfig, tyro.conf.OmitArgPrefixes] = field(
        default_factory=GpuBenchConfig
    )
    """Settings of the benchmark."""
    json: FilePath = None
    """Also write the result to this JSON file, after every row."""
    resume: bool = False
    """Measure only the rows that the JSON file lacks."""

    def run(self) -> None:
        """Measure and print."""
        if self.resume and self.json is None:
            raise UserError("--resume needs the JSON file to resume: add --json FILE.")
        check_json_path(self.json)
        before = None
        if self.resume and self.json is not None and self.json.exists():
            before = read_json(self.json)

        def save(result: dict[str, Any]) -> None:
            if self.json is not None:
                write_json(self.json, result)

        result = bench_gpu(self.config, save, before)
        print_gpu(result)
        write_json_table(self.json, result)


def print_gpu(result: dict[str, Any]) -> None:
    """Print a result of ``bench_gpu``: the table, errors, peak rates and the training run."""
    gpu, rows = result["machine"]["gpu"], []
    for row in result["rows"]:
        memory = {name: row[f"{name}_bytes"] for name in ("torch_peak", "device_used")}
        rows.append(row | {f"{k}_gib": None if v is None else v / 2**30 for k, v in memory.items()})
    print_table(
        f"{gpu['name'] if gpu else 'CPU'}, by number of environments",
        ["", *(f"{row['num_envs']:,}" for row in rows)],
        [[title, *(row.get(name) for row in rows)] for name, title in GPU_LINES.items()],
    )
    for row in rows:
        if row["error"]:
            print(f"{row['num_envs']:,} environments: {row['error']}")
    ceilings = [f"{k} {v:.3g}" for k, v in result["ceilings"].items() if v is not None]
    print(f"Peak rates: {', '.join(ceilings)}")
    if (training := result["training"]) is not None:
        print(
            f"{training['experiment']}: {training['step']:,} of {training['total_steps']:,} steps "
            f"in {training['minutes']:.2f} minutes, {training['evaluations']} interim evaluations"
        )


@dataclass(frozen=True, kw_only=True)
class Study:
    """Measure what running a study costs beyond its runs."""

    config: Annotated[StudyBenchConfig, tyro.conf.OmitArgPrefixes] = field(
        default_factory=StudyBenchConfig
    )
    """Settings of the benchmark."""
    json: FilePath = None
    """Also write the table to this JSON file."""

    def run(self) -> None:
        """Measure and print."""
        check_json_path(self.json)
        result = bench_study(self.config)
        print_table("Study", list(result), [list(result.values())])
        write_json_table(self.json, result)


COMMANDS: dict[str, type] = {"world": World, "learn": Learn, "gpu": Gpu, "study": Study}
"""Commands of the group, by name."""
