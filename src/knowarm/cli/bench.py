"""``knowarm bench``: speed of simulation, rendering and training on this machine."""

import os
import sys
from dataclasses import dataclass
from typing import Any

from knowarm.cli.tables import TableCommand, print_table
from knowarm.config import above_zero, at_least
from knowarm.cores import available_cores, processor
from knowarm.experiment.names import DEFAULT_EXPERIMENT, experiment_config
from knowarm.experiment.speed import (
    measure_images,
    measure_peak,
    measure_steps,
    measure_training,
    training_flops,
)
from knowarm.world.envs.vector_env import ArmVectorEnv


@dataclass(frozen=True, kw_only=True)
class Bench(TableCommand):
    """Measure how fast this machine simulates, renders and trains, in about half a minute."""

    experiment: str = DEFAULT_EXPERIMENT
    """Experiment whose robot, task and algorithm are measured."""
    num_envs: int = 256
    """Number of environments that are simulated in parallel."""
    seconds: float = 5.0
    """Least measuring time of each row [s]."""

    def result(self) -> dict[str, Any]:
        """Measure and print."""
        at_least(self, 1, "num_envs")
        above_zero(self, "seconds")
        config, cores = experiment_config(self.experiment), available_cores()
        steps = config.total_steps
        _announce("simulation with images")
        simulation = measure_steps(ArmVectorEnv(config.env, self.num_envs), self.seconds)
        _announce("images alone")
        images = measure_images(config.env, num_envs=self.num_envs, seconds=self.seconds)
        _announce("training, whose first update compiles code")
        training = measure_training(config, self.seconds)
        _announce("the processor's peak")
        peak, flops = measure_peak(cores, min(self.seconds, 1.0)), training_flops(config)
        share = training * flops / peak
        rows = [
            ("Simulation with images", round(simulation.steps_per_s), "steps/s"),
            ("Images alone, one core", round(images), "images/s"),
            ("Training: simulation, policy and learning", round(training), "steps/s"),
            ("Network: operations per training step", round(flops / 1e6, 1), "MFLOP"),
            ("Peak: one product of float32 matrices", round(peak / 1e9, 1), "GFLOP/s"),
            ("Share of the peak that the network uses", round(100 * share, 1), "%"),
            (f"Time to train all {steps:,} steps", steps / training / 3600, "hours"),
        ]
        title = f"{self.experiment} on {cores} cores, {self.num_envs} robots simulated at once"
        print_table(title, ["what", "value", "unit"], rows)
        return {
            "experiment": self.experiment,
            "num_envs": self.num_envs,
            "simulation_steps_per_s": simulation.steps_per_s,
            "simulation_steps_per_cpu_s": simulation.steps_per_cpu_s,
            "images_per_s_core": images,
            "training_steps_per_s": training,
            "training_flops": flops,
            "peak_flops_per_s": peak,
            "share_of_peak": share,
            "total_steps": steps,
            "machine": {"processor": processor(), "cores": cores, "cpus": os.cpu_count()},
        }


def _announce(what: str) -> None:
    print(f"Measuring {what} ...", file=sys.stderr, flush=True)
