"""Every input format: whole files, and the function of KnowArm that reads them."""

import bz2
import gzip
import io
import json
import lzma
import shutil
import signal
import traceback
import zipfile
import zlib
from collections.abc import Callable
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from functools import partial
from pathlib import Path

import networkx
import numpy as np

from benchmarks.apartment_graph import write_openke
from benchmarks.triple_splits import split_graph
from knowarm.cli.train import Train
from knowarm.errors import UserError
from knowarm.experiment.csv_log import CsvLog
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.load import load_agent
from knowarm.experiment.run import train
from knowarm.experiment.run_folder import PERCEPTION_FILE, RunFolder
from knowarm.experiment.summary import read_film, read_table
from knowarm.fence import Fence
from knowarm.knowledge import household, read_graph
from knowarm.knowledge.formats import write_graph
from knowarm.knowledge.kge import KgeConfig
from knowarm.knowledge.kge.train import save_model
from knowarm.knowledge.kge.train import train as train_embedding
from knowarm.knowledge.queries.sparql import EXAMPLE, sparql
from knowarm.knowledge.vectors.graph_embedding import stored_lookup
from knowarm.knowledge.vectors.words import read_word_vectors
from knowarm.learn.checkpoint import read_checkpoint
from knowarm.perception.grounding import GroundingNetwork
from knowarm.report import write_report
from knowarm.report.collect import collect
from tests.robustness.further_formats import Reader, further_readers
from tests.robustness.mutator import mutate
from tests.robustness.packs import pack_readers
from tests.tiny import CHOOSE, CHOOSE_NAME, short

STALL_S = 60
"""Time after which reading one file counts as a failure; only where the system has timers [s]."""


class Stall(BaseException):
    """Reading took more processor time than `STALL_S`."""


def try_mutations(reader: Reader, seeds: range) -> list[str]:
    """Read mutations of a format's file; return those that end in a traceback or a stall.

    One fenced process reads all that fits its limits, so that not every file costs a fork. What
    crosses a limit, or fails there, is read again in this process, which decides.
    """
    name, path, _ = reader
    original = path.read_bytes()
    failures = []
    trial = Fence(partial(try_mutation, reader, original))
    try:
        for seed in seeds:
            what: str | None = "it crosses a limit"
            with suppress(ValueError):
                what = trial(seed)
            if what is not None:
                what = try_mutation(reader, original, seed)
            if what is not None:
                failures.append(f"{name}, seed {seed}: {what}")
    finally:
        trial.close()
        path.write_bytes(original)
    return failures


def try_mutation(reader: Reader, original: bytes, seed: int) -> str | None:
    """Read a mutation of a format's file; return what failed, or None."""
    name, path, read = reader
    random = np.random.default_rng((seed, zlib.crc32(name.encode())))
    path.write_bytes(mutate(original, random, is_json=path.suffix == ".json"))
    return outcome(partial(read, path))


def outcome(read: Callable[[], object]) -> str | None:
    """Run a reader; return None for a result or an error for users, else what it raised."""
    try:
        with _timer(), redirect_stderr(io.StringIO()), redirect_stdout(io.StringIO()):
            read()
    except UserError as error:
        return f"message of several lines: {error}" if "\n" in str(error) else None
    except SystemExit as error:
        return None if error.code in (0, 2) else f"exit code {error.code}"
    except Stall:
        return f"took more than {STALL_S} s of processor time"
    except BaseException as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__}: {error} ({frame.filename}:{frame.lineno})"[
            :300
        ]
    return None


@contextmanager
def _timer():
    if not hasattr(signal, "setitimer"):
        yield
        return

    def stall(number, frame):
        raise Stall

    # Of processor time, so that a busy machine makes no failure.
    before = signal.signal(signal.SIGPROF, stall)
    signal.setitimer(signal.ITIMER_PROF, STALL_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def make_formats(folder: Path) -> list[Reader]:
    """Write whole files of all formats into a folder."""
    return [
        *_graphs(folder / "graphs ä"),
        *_vectors(folder / "vectors"),
        *_run(folder / "runs"),
        *_perception(folder / "perception"),
        *pack_readers(folder / "packs"),
        *further_readers(folder / "further"),
        *_texts(folder),
    ]


def _graphs(folder: Path) -> list[Reader]:
    graph = household()
    readers: list[Reader] = []
    folder.mkdir(parents=True)
    for suffix in ("ttl", "nt", "rdf", "jsonld", "csv", "tsv"):
        path = folder / f"home.{suffix}"
        write_graph(graph, path)
        readers.append((f"graph .{suffix}", path, read_graph))
    links = [{"source": h, "type": r, "target": t} for h, r, t in graph]
    network = networkx.MultiDiGraph()
    network.add_edges_from((h, t, {"label": r}) for h, r, t in graph)
    for name, text in {
        "home.json": json.dumps(
            {"nodes": [{"id": n} for n in graph.entities], "links": links}
        ),
        "home.graphml": "\n".join(networkx.generate_graphml(network)),
        "home.gexf": "\n".join(networkx.generate_gexf(network)),
        "home.trig": (folder / "home.ttl").read_text("utf-8"),
        "home.nq": (folder / "home.nt").read_text("utf-8"),
        "train.txt": (folder / "home.tsv").read_text("utf-8"),
    }.items():
        (folder / name).write_text(text, "utf-8")
        readers.append((f"graph {name}", folder / name, read_graph))
    small = (folder / "home.nt").read_bytes()[:20_000].rsplit(b"\n", 1)[0] + b"\n"
    for suffix, compress in (
        ("gz", gzip.compress),
        ("bz2", bz2.compress),
        ("xz", lzma.compress),
    ):
        path = folder / f"small.nt.{suffix}"
        path.write_bytes(compress(small))
        readers.append((f"graph .nt.{suffix}", path, read_graph))
    path = folder / "small.nt.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("small.nt", small)
    readers.append(("graph .nt.zip", path, read_graph))
    openke = folder / "openke"
    write_openke(split_graph(graph), openke)
    readers += [
        (
            f"OpenKE {name}",
            openke / f"{name}2id.txt",
            lambda path: read_graph(path.parent),
        )
        for name in ("entity", "relation", "train")
    ]
    path = folder / "conceptnet-assertions-5.7.0.csv"
    line = (
        '/a/x{0}\t/r/IsA\t/c/en/mug{0}\t/c/en/cup/n\t{{"weight": 2.0, "sources": []}}\n'
    )
    path.write_text("".join(line.format(i) for i in range(40)))
    return [*readers, ("ConceptNet", path, read_graph)]


def _vectors(folder: Path) -> list[Reader]:
    folder.mkdir()
    random = np.random.default_rng(0)
    text = "".join(
        f"word{i} " + " ".join(f"{x:.4f}" for x in random.normal(size=20)) + "\n"
        for i in range(150)
    ).encode()
    plain, packed, zipped = (
        folder / f"words.txt{suffix}" for suffix in ("", ".gz", ".zip")
    )
    plain.write_bytes(text)
    packed.write_bytes(gzip.compress(text))
    with zipfile.ZipFile(zipped, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("words.txt", text)
    config = KgeConfig(dim=4, epochs=1)
    graph = household()
    trained = train_embedding(
        config, graph.triples, len(graph.names), len(graph.relation_names)
    )
    embedding = folder / "home.safetensors"
    save_model(trained.model, config, graph, embedding)
    return [
        *(
            (f"word vectors {p.suffix}", p, read_word_vectors)
            for p in (plain, packed, zipped)
        ),
        ("graph embedding", embedding, lambda path: stored_lookup(path, graph)),
    ]


def _run(folder: Path) -> list[Reader]:
    config = short(total_steps=40, checkpoint_every_steps=20)
    run = train(config, folder, policy={"features": 8}).folder
    values = {
        "episodes": 2,
        "probes": [{"kind": "steps"}, {"kind": "films", "episodes": 1}],
    }
    evaluated = evaluate(run.path, **values, label="two").folder

    def reported(path: Path) -> None:
        write_report([run.path], folder / "report.html")

    def logs(path: Path) -> None:
        before = path.read_bytes()
        CsvLog(path, keep_to_step=20).write({"step": 40, "new": 1.0})
        path.write_bytes(before)
        collect([run.path])

    def loaded(path: Path) -> None:
        load_agent(run.path, which="latest")

    def checkpoint(path: Path) -> None:
        read_checkpoint(path.parent)

    latest = run.checkpoints / "latest"
    return [
        (
            "config.json",
            run.config_path,
            lambda path: RunFolder.open(run.path).experiment(),
        ),
        ("config.json in a report", run.config_path, reported),
        ("provenance.json", run.path / "provenance.json", loaded),
        ("provenance.json in a report", run.path / "provenance.json", reported),
        ("knowledge.safetensors", run.path / "knowledge.safetensors", loaded),
        ("metrics.csv", run.metrics_path, logs),
        ("evaluations.csv", run.evaluations_path, logs),
        ("checkpoint meta.json", latest / "meta.json", checkpoint),
        *(
            (f"checkpoint {p}", latest / f"{p}.safetensors", loaded)
            for p in ("policy", "state")
        ),
        ("summary.json in a report", evaluated / "summary.json", reported),
        ("episodes.parquet in a report", evaluated / "episodes.parquet", reported),
        ("evaluations.csv in a report", run.evaluations_path, reported),
        ("episodes.parquet", evaluated / "episodes.parquet", read_table),
        ("steps.parquet", evaluated / "steps.parquet", read_table),
        ("film", evaluated / "films" / "0.webp", read_film),
    ]


def _perception(folder: Path) -> list[Reader]:
    run = train(CHOOSE_NAME, folder, **CHOOSE).folder
    path = Path(shutil.copy(run.path / PERCEPTION_FILE, folder / "network.safetensors"))
    return [
        ("grounding network", path, GroundingNetwork.read),
        (
            "perception.safetensors of a run",
            run.path / PERCEPTION_FILE,
            lambda _: load_agent(run.path),
        ),
    ]


def _texts(folder: Path) -> list[Reader]:
    graph = household()
    query = folder / "query.rq"
    query.write_text(
        EXAMPLE
        + "\n" * 3
        + '# OPTIONAL { ?x :isA ?y } FILTER(?colour != "red") LIMIT 10\n'
    )
    options = folder / "options.txt"
    options.write_text(
        "--seed 3 --total-steps 1000 --env.mpi-rad 0.1 --env.image-size 64 --interim.episodes 4 "
        "--algorithm.num-envs 64 --algorithm.gamma 0.9 --knows.source.kind words"
    )
    name = "irb120-full-ppo"
    return [
        (
            "SPARQL",
            query,
            lambda p: sparql(graph, p.read_bytes().decode(errors="replace")),
        ),
        (
            "command line",
            options,
            lambda p: Train.parse(
                "", [name, *p.read_bytes().decode(errors="replace").split()]
            ),
        ),
    ]
