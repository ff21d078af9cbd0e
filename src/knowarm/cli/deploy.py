"""``knowarm export`` and ``knowarm serve``: a trained policy outside of the simulator."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from knowarm.experiment.load import Which, load_agent
from knowarm.integrations.contract import deployment
from knowarm.integrations.export import export

RunPath = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]


@dataclass(frozen=True, kw_only=True)
class Export:
    """Write a trained policy as ONNX, with its contract and a runner without PyTorch."""

    run_folder: RunPath
    """Run folder, such as runs/irb120-full-fast/0."""
    to: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("exported")
    """Folder to write."""
    which: Which = "best"
    """Checkpoint of the run: best interim evaluation, latest, or untrained."""

    def run(self) -> None:
        """Export and say what was written."""
        contract = export(load_agent(self.run_folder, which=self.which), self.to).contract
        print(f"Wrote {', '.join(sorted(each.name for each in self.to.iterdir()))} to {self.to}.")
        rows = contract["knowledge"]["rows"]
        print(f"Rows of knowledge.npy: {len(rows)}, such as {rows[0]!r}.")
        if not contract["success"]:
            print(f"Not evaluated: `knowarm evaluate {self.run_folder}` adds its success.")


@dataclass(frozen=True, kw_only=True)
class Serve:
    """Serve a trained policy over the WebSocket protocol of openpi, until Ctrl-C."""

    run_folder: RunPath
    """Run folder, such as runs/irb120-full-fast/0."""
    host: str = "127.0.0.1"
    """Address to listen on. Others than the loopback need a key, in KNOWARM_SERVE_KEY."""
    port: int = 8000
    """Port; 0 takes a free one."""
    which: Which = "best"
    """Checkpoint of the run: best interim evaluation, latest, or untrained."""

    def run(self) -> None:
        """Serve and print the address."""
        from knowarm.integrations.serve import PolicyServer

        parts = deployment(load_agent(self.run_folder, which=self.which))
        key = os.environ.get("KNOWARM_SERVE_KEY") or None
        server = PolicyServer(parts.runner, host=self.host, port=self.port, key=key)
        print(
            f"Serving {self.run_folder} on ws://{self.host}:{server.port} until Ctrl-C.", flush=True
        )
        server.run()
