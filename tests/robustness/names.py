"""Campaign of names: what users and files may choose is printed as text, never as markup."""

import contextlib
import io
import random
import tempfile
from collections.abc import Callable
from pathlib import Path

from knowarm.cli.main import main
from knowarm.knowledge.formats import write_graph
from knowarm.knowledge.graph.builder import graph_of
from knowarm.knowledge.graph.terms import literal
from tests.robustness.formats import outcome

PARTS = ["[/foo]", "[bold]", "[link=x]", "[/]", "[", "]", "[@click=a]", "\\[", ":smile:", "a", " "]
PARTS += ["\x1b[31m", "\x1b]0;x\a", "\u202e", "\r", "{0}", "%s", "ä", "\U0001f600", "<b>", '"', "'"]
SUFFIXES = (".ttl", ".nt", ".csv", ".jsonld")


def _printed(arguments: list[str]) -> Callable[[], None]:
    """Return a function that runs a command, whose output must not act on a terminal."""

    def run() -> None:
        out, errors = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
            main(arguments)
        table = "".join(line for line in out.getvalue().splitlines() if line.startswith("│"))
        assert table.isprintable(), f"{table!r}"
        assert errors.getvalue().replace("\n", "").isprintable() or "╭" in errors.getvalue()

    return run


def print_names(tries: int, seed: int) -> tuple[int, list[str]]:
    """Use random names wherever a user or a file can choose one."""
    draws, failures = random.Random(seed), []
    with tempfile.TemporaryDirectory() as temporary:
        for number in range(tries):
            a, b, c = ("".join(draws.choices(PARTS, k=draws.randint(1, 4))) for _ in range(3))
            suffix = SUFFIXES[number % len(SUFFIXES)]
            path = Path(temporary) / f"{a}{suffix}"
            label = ("hasColor", "http://www.w3.org/2000/01/rdf-schema#label", literal(c))
            triples = [(a, b, c), ("mug", b, a), (a, *label[1:]), ("mug", "hasColor", c)]
            write_graph(graph_of(triples), path)
            graph = ["knowledge", "subgraph", "--graph", str(path)]
            for arguments in (
                graph,
                [*graph, "--statistics"],
                [*graph, "--sparql", "SELECT * { ?s ?p ?o }"],
                [*graph, "--objects", a],
                ["knowledge", "queries", "--graph", str(path), "--ask", f"{b} {c}"],
                ["knowledge", "draw", "--graph", str(path), "--title", a, "--out", f"{path}.svg"],
                ["knowledge", "show", "--graph", str(path), "--objects", a],
                ["knowledge", "evaluate", a],
                ["evaluate", "zero", "--label", a, "--episodes", "1", "--blind-episodes", "0"],
                ["evaluate", f"{a}/0"],
                ["doctor", "--robot", f"{a}.toml"],
                ["report", a],
                ["study", "run", a],
                ["train", a],
                ["list", f"--{a}"],
                [a],
            ):
                what = outcome(_printed(arguments))
                failures += [] if what is None else [f"{arguments}: {what}"]
    return tries, failures
