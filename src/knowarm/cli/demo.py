"""``knowarm demo``: the main job in a quarter of an hour."""

from dataclasses import dataclass
from pathlib import Path

from knowarm.experiment.demo import STEPS, demo
from knowarm.experiment.run import StopRequest
from knowarm.report import report


@dataclass(frozen=True, kw_only=True)
class Demo:
    """Train bm and full on IRB120 for a small budget, evaluate both, and write one report."""

    out: Path = Path("runs/demo")
    """Folder of the two runs and of report.html."""
    steps: int = STEPS
    """Environment steps each agent is trained for."""

    def run(self) -> None:
        """Run the demo."""
        with StopRequest() as should_stop:
            runs = demo(self.out, steps=self.steps, should_stop=should_stop)
        if runs is None:
            print("Stopped and saved. The same command goes on from here.")
        else:
            path = report(runs, self.out / "report.html")
            print(f"Wrote {path}: open it in a browser.")


COMMAND = Demo
