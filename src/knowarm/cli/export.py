"""``knowarm export``: a run goes in; one step of its policy as an ONNX file comes out."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from knowarm.experiment.build import Which, load_agent
from knowarm.policy.onnx_export import INPUTS, OUTPUTS, export_onnx


@dataclass(frozen=True, kw_only=True)
class Export:
    """Write a trained policy as ONNX: one step, recurrent state in and out."""

    run_folder: tyro.conf.Positional[Path]
    """The run, such as runs/irb120-full-ppo/0."""
    out: Path = Path("policy.onnx")
    """The file to write."""
    which: Which = "best"
    """Which policy of the run: of the best interim evaluation, the latest, or untrained."""

    def run(self) -> None:
        """Export, and say how to use the file."""
        trained = load_agent(self.run_folder, which=self.which)
        export_onnx(trained.policy, self.out)
        print(f"Wrote {self.out}: inputs {', '.join(INPUTS)}; outputs {', '.join(OUTPUTS)}.")
        print("The knowledge of each facet is the table in the run's knowledge.safetensors.")


COMMAND = Export
