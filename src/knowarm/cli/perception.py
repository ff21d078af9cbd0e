"""``knowarm perception train``: a module that names the visible objects and their colours."""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from knowarm.cli.tables import FilePath, check_json_path, print_table, write_json_table
from knowarm.config import to_dict
from knowarm.errors import UserError, unknown_name
from knowarm.experiment.perception import PerceptionConfig, write_perception
from knowarm.experiment.perception_training import train_perception
from knowarm.experiment.registry import experiment_config
from knowarm.world.config import EnvConfig

USAGE = """usage: knowarm perception train EXPERIMENT --out FILE [OPTIONS]

Train a module that names the visible objects and their colours in the images of an experiment.
`knowarm train EXPERIMENT --perception FILE` tells an agent of scope "perceived" what it names.

  knowarm perception train irb120-target-perceived-dr-fast --help"""


@dataclass(frozen=True, kw_only=True)
class TrainPerception:
    """Train a module that names the visible objects and their colours, and print its accuracy."""

    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """File of the module, FILE.safetensors."""
    training: Annotated[PerceptionConfig, tyro.conf.OmitArgPrefixes] = field(
        default_factory=PerceptionConfig
    )
    """Images, epochs and seed."""
    env: EnvConfig = field(default_factory=EnvConfig)
    """The task; its defaults are the experiment's."""
    json: FilePath = None
    """Also write the accuracy to this JSON file."""

    def run(self) -> None:
        """Train, print and write."""
        check_json_path(self.json)
        if self.out.suffix != ".safetensors":
            raise UserError(f"--out {self.out}: perception modules are written as .safetensors.")
        perception = train_perception(self.env, self.training, report=_report)
        seen = perception.seen
        rows = [
            [name, *(100 * shares.get(key, float("nan")) for key in ("objects", "colours", "both"))]
            for name, shares in seen.accuracy.items()
        ]
        title = f"Named rightly of {self.training.test_images:,} images"
        print_table(title, ["test", "objects %", "their colours %", "both %"], rows)
        for name, shares in seen.accuracy.items():
            if "told" in shares:
                print(f"Surest answer to the query, {name}: {100 * shares['told']:.1f} % right.")
        write_perception(perception, self.out)
        print(f"Wrote {self.out}")
        write_json_table(self.json, to_dict(seen))


def _report(epoch: int, loss: float) -> None:
    print(f"epoch {epoch}: loss {loss:.3f}", file=sys.stderr, flush=True)


def parse(arguments: list[str]) -> TrainPerception:
    """Parse the words after `knowarm perception`.

    The experiment's name is read first: the other arguments override its task.
    """
    if not arguments or arguments[0] in ("-h", "--help"):
        print(USAGE)
        sys.exit(0)
    command, *rest = arguments
    if command != "train":
        raise unknown_name("perception command", command, ["train"])
    if not rest or rest[0] in ("-h", "--help"):
        print(USAGE)
        sys.exit(0)
    name, *rest = rest
    if name.startswith("-"):
        raise UserError(
            f"The first argument must be the name of an experiment, got {name}; `knowarm list` "
            "explains their names."
        )
    default = TrainPerception(out=tyro.MISSING, env=experiment_config(name).env)
    return tyro.cli(
        TrainPerception, prog=f"knowarm perception train {name}", args=rest, default=default
    )
