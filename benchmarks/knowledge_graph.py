"""Benchmark of the graph store: load time, memory and query time on random graphs.

A graph has a tenth as many entities as triples; every twentieth triple points to one of a few hubs,
so that a hub has some 300 edges. Each size is measured in a process of its own. Memory is the
growth of the process by reading, divided by the number of triples.

On a busy machine compare CPU seconds rather than wall time.

    python -m benchmarks.knowledge_graph --json runs/bench/knowledge_graph.json
"""

import argparse
import gc
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil

from knowarm.cli.tables import print_table
from knowarm.knowledge import KnowledgeGraph, gamma, read_graph
from knowarm.knowledge.graph.graph import Direction

RELATIONS = 30
QUERIES = 2_000


def write_random_graph(path: Path, triples: int, seed: int = 0) -> None:
    """Write N-Triples of IRIs about 40 letters long."""
    generator = np.random.default_rng(seed)
    entities, hubs = triples // 10, max(1, triples // 6000)
    heads = generator.integers(entities, size=triples)
    tails = generator.integers(entities, size=triples)
    to_hub = generator.random(triples) < 0.05
    tails[to_hub] = generator.integers(hubs, size=to_hub.sum())
    relations = generator.integers(RELATIONS, size=triples)
    name, relation = (
        "http://example.org/home/thing/{:08d}",
        "http://example.org/home/rel/{:02d}",
    )
    with path.open("w") as file:
        for h, r, t in zip(
            heads.tolist(), relations.tolist(), tails.tolist(), strict=True
        ):
            file.write(
                f"<{name.format(h)}> <{relation.format(r)}> <{name.format(t)}> .\n"
            )


def own_bytes(graph: KnowledgeGraph) -> int:
    """Count the bytes held by triples and names."""
    arrays = (
        graph.heads,
        graph.relations,
        graph.tails,
        graph.by_tail,
        graph.tails_sorted,
    )
    tables = (graph.names, graph.relation_names)
    names = sum(
        sys.getsizeof(table) + sum(map(sys.getsizeof, table)) for table in tables
    )
    return sum(a.nbytes for a in arrays) + graph.nodes.nbytes + names


def measure(path: Path) -> dict[str, float]:
    """Read the graph and query it in this process."""
    process = psutil.Process()
    gc.collect()
    before = process.memory_info().rss
    start, start_cpu = time.perf_counter(), time.process_time()
    graph = read_graph(path)
    load, load_cpu = time.perf_counter() - start, time.process_time() - start_cpu
    own = own_bytes(graph)  # makes the order by tail, so that the next line counts it
    gc.collect()
    held = process.memory_info().rss - before
    generator = np.random.default_rng(1)
    asked = [graph.names[i] for i in generator.choice(graph.nodes, QUERIES)]
    degree = np.bincount(graph.tails, minlength=len(graph.names))
    hubs = [graph.names[i] for i in np.argsort(-degree)[: QUERIES // 20]]
    values = {"triples": len(graph), "load_s": load, "load_cpu_s": load_cpu}
    values |= {
        "triples_per_s": len(graph) / load,
        "triples_per_cpu_s": len(graph) / load_cpu,
    }
    values |= {"own_bytes_per_triple": own / len(graph)}
    values |= {"rss_bytes_per_triple": held / len(graph)}
    rows: list[tuple[str, list[str], Direction]] = [
        ("query_ms", asked, "out"),
        ("hub_query_ms", hubs, "in"),
    ]
    for label, names, direction in rows:
        gamma(graph, [names[0]], direction=direction)
        times = []
        for name in names:
            start = time.perf_counter()
            gamma(graph, [name], direction=direction)
            times.append(time.perf_counter() - start)
        values[label] = 1e3 * float(np.median(times))
    values["hub_degree"] = float(degree.max())
    return values


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[500_000, 3_000_000])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        print(json.dumps(measure(arguments.measure)))
        return
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for size in arguments.sizes:
            path = Path(folder) / f"{size}.nt"
            write_random_graph(path, size)
            command = [sys.executable, __file__, "--measure", str(path)]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            rows.append(json.loads(done.stdout))
            path.unlink()
    sizes = [f"{row['triples']:,} triples" for row in rows]
    print_table(
        "Graph store",
        ["measure", *sizes],
        [[k, *(row[k] for row in rows)] for k in rows[0]],
    )
    if arguments.json:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
