"""Choices of the GPU's measurements go in; a checked config comes out."""

from dataclasses import dataclass

from knowarm.errors import UserError
from knowarm.learn.device import PrecisionChoice


@dataclass(frozen=True, kw_only=True)
class GpuBenchConfig:
    """What is measured, and for how long."""

    device: str = "cuda"
    """"cuda", or "cpu" for checking the measuring itself."""

    robot: str = "irb120"
    """Robot of the experiment ``<robot>-full-ppo``."""

    num_envs: tuple[int, ...] = (256, 1024, 4096, 16384)
    """Numbers of environments, a row each."""

    seconds: float = 5.0
    """Time each figure is measured for, at least."""

    image_size: int = 64
    """Side of the images [px]."""

    training: bool = True
    """Measure training, too."""

    matmul_precision: PrecisionChoice = "auto"
    """Of the products in training, as PPO's."""

    rollout_steps: int = 25
    """Steps of each environment between two updates."""

    epochs: int = 2
    """Passes over each rollout."""

    minibatch_envs: int = 256
    """Most environments of a minibatch."""

    copy_bytes: int = 2**30
    """Size of the array whose copying gives the bandwidth."""

    matmul_side: int = 8192
    """Side of the square matrices whose product gives the rates of operations."""

    seed: int = 0
    """Seed of everything."""

    def __post_init__(self) -> None:
        for name in (
            "image_size",
            "rollout_steps",
            "epochs",
            "minibatch_envs",
            "copy_bytes",
            "matmul_side",
        ):
            if getattr(self, name) < 1:
                raise UserError(f"{name} must be at least 1, got {getattr(self, name)}.")
        if not self.seconds > 0:
            raise UserError(f"seconds must be larger than 0, got {self.seconds}.")
        if not self.num_envs or min(self.num_envs) < 1:
            raise UserError(f"num_envs must be numbers of at least 1, got {self.num_envs}.")
