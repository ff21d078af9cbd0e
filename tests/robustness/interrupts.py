"""Campaign of Ctrl-C: commands that are in long work of a library end at once, in one line."""

import os
import random
import signal
import tempfile
from pathlib import Path

from knowarm.cli.main import main
from tests.forked import Forked

END_S = 15.0
"""Time within which a command must end."""
RDF = '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" xmlns:x="http://x/">'
CROSSED = "SELECT (COUNT(*) AS ?n) { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i . ?j ?k ?l FILTER(?c != ?l) }"
OUT = "out.nt"


def long_commands(folder: Path, triples: int) -> dict[str, list[str]]:
    """Write inputs that take a minute or more into a folder; return commands that read them."""
    attributes = " ".join(f'x:a{i}="b"' for i in range(400_000))
    (folder / "a.rdf").write_text(f"{RDF}<rdf:Description {attributes}/></rdf:RDF>")
    with (folder / "a.nt").open("w") as file:
        for i in range(triples):
            file.write(f"<http://a/{i % 999_983}> <http://b/{i % 97}> <http://c/{i}> .\n")
    subgraph = ["knowledge", "subgraph", "--out", OUT]
    return {
        "RDF/XML": [*subgraph, "--graph", "a.rdf"],
        "N-Triples": [*subgraph, "--graph", "a.nt"],
        "SPARQL": ["knowledge", "subgraph", "--sparql", CROSSED],
    }


def interrupt(arguments: list[str], folder: Path, after_s: float) -> str | None:
    """Run a command, interrupt it once, and return what is wrong with its end, or None."""
    before = set(folder.iterdir())
    with tempfile.TemporaryDirectory() as output:
        running = Forked(lambda: main(arguments), Path(output), cwd=folder)
        try:
            if running.ended(after_s):
                return f"ended by itself: {running.stderr[-300:]}"
            os.kill(running.process.pid, signal.SIGINT)
            if not running.ended(END_S):
                return f"goes on for more than {END_S:.0f} s"
        finally:
            running.process.kill()
        if running.returncode != 130 or running.stderr != "knowarm: interrupted\n":
            return f"exit code {running.returncode}, {running.stderr[-300:]!r}"
    left = [path.name for path in set(folder.iterdir()) - before]
    return f"leaves {left}" if left else None


def interrupt_commands(tries: int, seed: int, triples: int = 10_000_000) -> tuple[int, list[str]]:
    """Interrupt commands at random moments of their work."""
    draws, failures = random.Random(seed), []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        commands = long_commands(folder, triples)
        for number in range(tries):
            name = list(commands)[number % len(commands)]
            after_s = draws.uniform(8, 50)
            if (what := interrupt(commands[name], folder, after_s)) is not None:
                failures.append(f"{name} after {after_s:.1f} s: {what}")
    return tries, failures
