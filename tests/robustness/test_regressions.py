"""Inputs that once ended in a traceback, a crash or gigabytes; see docs/reliability.md."""

import errno
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from safetensors.numpy import save_file
from safetensors.torch import load_file
from safetensors.torch import save_file as save_tensors

from knowarm.benchmark.policies import is_safe
from knowarm.benchmark.rows import read_row
from knowarm.cli.main import main
from knowarm.errors import UserError
from knowarm.experiment.load import load_agent
from knowarm.experiment.logs import RunLogs, TrainingProgress
from knowarm.experiment.run_folder import RunFolder
from knowarm.experiment.summary import FRAME_MS, MAX_FRAMES, read_film
from knowarm.knowledge import household, read_graph
from knowarm.knowledge.graph.graph import gamma
from knowarm.knowledge.kge import KgeConfig
from knowarm.knowledge.kge.train import FORMAT, load_model, new_model, save_model
from knowarm.knowledge.queries.sparql import sparql
from knowarm.learn.checkpoint import Checkpoint, CheckpointStore, read_checkpoint
from knowarm.reading import read_json, write_json
from knowarm.world.description import read_description
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.mjcf import read_mjcf
from tests.robustness.test_permuted_doors import ROWS

ZOO = Path(__file__).parent.parent.parent / "zoo"
FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.fixture(scope="module")
def embedding(tmp_path_factory):
    graph, config = household(), KgeConfig(dim=4)
    path = tmp_path_factory.mktemp("embedding") / "home.safetensors"
    save_model(
        new_model(config, len(graph.names), len(graph.relation_names)),
        config,
        graph,
        path,
    )
    return path


@pytest.mark.parametrize(
    ("config", "scale", "message"),
    [
        ("{", 1.0, "damaged or of another format"),
        (None, float("nan"), "non-finite"),
    ],
)
def test_damaged_graph_embeddings(tmp_path, embedding, config, scale, message):
    tensors = load_file(embedding)
    tensors = {n: t * scale if t.is_floating_point() else t for n, t in tensors.items()}
    config = config or json.dumps({"model": "analogy", "dim": 4})
    path = tmp_path / "a.safetensors"
    save_tensors(tensors, path, {"format": FORMAT, "config": config})
    with pytest.raises(UserError, match=message):
        load_model(path)


@pytest.mark.parametrize(
    "table",
    [np.zeros(3, np.float32), np.zeros((2, 3)), np.full((2, 3), np.nan, np.float32)],
)
def test_damaged_knowledge(tmp_path, table):
    save_file({"table": table}, tmp_path / "knowledge.safetensors")
    with pytest.raises(UserError, match="matrix of finite float32"):
        RunFolder(tmp_path).knowledge()


@pytest.mark.parametrize(
    "meta", ["[]", "{}", '{"facts": 3, "description": {}}', '{"description": 3}']
)
def test_damaged_facts_of_a_checkpoint(tmp_path, meta):
    store = CheckpointStore(tmp_path, {})
    store.save(Checkpoint(policy={}, facts={"step": 1}))
    (tmp_path / "latest" / "meta.json").write_text(meta)
    with pytest.raises(UserError, match=r"meta\.json.*restore it or delete it"):
        read_checkpoint(tmp_path / "latest")


def test_a_full_disk_while_a_curve_is_written_for_tensorboard(tmp_path, monkeypatch):
    logs = RunLogs(RunFolder(tmp_path), TrainingProgress("run", 10))
    logs.open(keep_to_step=None)

    def full(*arguments, **options):
        raise FULL

    monkeypatch.setattr(logs._tensorboard, "add_scalar", full)
    with pytest.raises(
        UserError, match=r"Cannot write .*tensorboard: No space left on device"
    ):
        logs.metrics({"step": 1, "loss": 0.5})
    logs.close()


def test_a_full_disk_while_arrays_are_written(tmp_path, embedding):
    """Its own function for files would raise an error that is no `OSError`."""
    (tmp_path / "file").write_text("")
    with pytest.raises(
        UserError, match=r"Cannot write .*knowledge\.safetensors: File exists"
    ):
        RunFolder(tmp_path / "file").write_knowledge(np.zeros((2, 3), np.float32))
    stored = load_model(embedding)
    with pytest.raises(UserError, match=r"Cannot write .*: Is a directory"):
        save_model(stored.model, stored.config, household(), tmp_path)


@pytest.mark.parametrize(
    "policy", [None, 3, {"config": 3, "shape": {}}, {"config": {}}]
)
def test_damaged_provenance(tmp_path, policy):
    run = shutil.copytree(ZOO / "irb120-full-fast", tmp_path / "run")
    values = json.loads((run / "provenance.json").read_text())
    values["policy"] = policy
    (run / "provenance.json").write_text(json.dumps(values))
    with pytest.raises(UserError):
        load_agent(run)


def test_an_over_long_path_of_a_runs_graph(tmp_path):
    """A copy of such a name cannot exist, and nothing else is opened."""
    run = RunFolder(shutil.copytree(ZOO / "irb120-full-fast", tmp_path / "run"))
    values = json.loads(run.config_path.read_text())
    values["knows"]["graph"] = "a" * 5000
    run.config_path.write_text(json.dumps(values))
    assert run.config()["knows"]["graph"].startswith(str(run.path / "graphs"))
    assert load_agent(run.path).step > 0


def test_over_long_names_of_a_row(tmp_path):
    """No folder can have such a name, and asking for it is an error of the system."""
    row = read_json(sorted(ROWS.iterdir())[0])
    write_json(tmp_path / "row.json", row | {"suite": "a" * 5000})
    with pytest.raises(UserError, match=r"row\.json: suite: File name too long\.$"):
        read_row(tmp_path / "row.json")
    for spec in ("a" * 300, "seen:" + "a" * 300, "zoo/" + "a" * 300):
        assert not is_safe(spec)


def test_hops_end_where_the_graph_does():
    graph = household()
    every = gamma(graph, ["mug"], hops=len(graph))
    assert np.array_equal(gamma(graph, ["mug"], hops=10**12).nodes, every.nodes)


def test_a_film_of_very_many_images(tmp_path):
    images = [Image.new("RGB", (4, 4), colour) for colour in ("red", "blue")]
    duration = 2 * MAX_FRAMES * FRAME_MS
    images[0].save(
        tmp_path / "0.webp",
        save_all=True,
        append_images=images[1:],
        duration=[duration] * 2,
    )
    with pytest.raises(UserError, match="shows more than"):
        read_film(tmp_path / "0.webp")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.nt", '<http://a> <http://b> "\\uD800" .\n'),
        ("b.jsonld", '{"@id": "http://a", "http://b": "\\ud800"}'),
        ("c.nt", "<urn:knowarm:%ED%A0%80> <urn:knowarm:b> <urn:knowarm:c> .\n"),
    ],
)
def test_half_of_a_surrogate_pair_in_a_graph(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    try:
        graph = read_graph(tmp_path / name)
    except UserError:
        return
    assert " ".join(" ".join(triple) for triple in graph).encode()


def test_an_over_long_path_of_a_robots_file(tmp_path):
    with pytest.raises(UserError, match=r"Cannot read .*File name too long"):
        read_mjcf(tmp_path / ("a" * 5000), "Robot 'own'")


def test_toml_that_is_nested_very_deep(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text("a = " + "[" * 50_000)
    with pytest.raises(UserError, match="is not TOML"):
        read_description(path, Robot)


@pytest.mark.parametrize("query", ["\ud800", "SELECT (<http://x/f>(1) AS ?y) {}"])
def test_queries_that_the_engine_refuses(query):
    with pytest.raises(UserError, match=r"SPARQL query: .*Example"):
        sparql(household(), query)


@pytest.mark.parametrize(
    "before", ["# '\n", '"#"', "'a\\'#'", "<http://a#b>", ":a\\#", '"""\n"#"""']
)
@pytest.mark.parametrize(
    "service", ["SERVICE <http://a>", "service silent:s", "1SERVICE ?s"]
)
def test_service_is_refused_wherever_it_stands(before, service):
    with pytest.raises(UserError, match="nothing is fetched"):
        sparql(household(), f"ASK {{ ?s ?p {before} {service}{{ ?s ?p ?o }} }}")


LONG = "a" * 5000
ODD = "x\x1b[31m\n\u202ey"


@pytest.mark.parametrize(
    "arguments",
    [
        ["evaluate", f"{LONG}/0"],
        ["report", LONG],
        ["export", LONG],
        ["train", "irb120-bm-ppo", "--resume", "--runs", LONG],
        ["knowledge", "show", "--graph", f"{LONG}.ttl"],
        ["knowledge", "fit", "--graph", LONG],
        ["study", "run", LONG],
        ["evaluate", f"{ODD}/0"],
        ["report", ODD],
        ["knowledge", "show", "--graph", f"{ODD}.ttl"],
        pytest.param(
            ["list", "--json", "/dev/full"],
            marks=pytest.mark.skipif(
                not Path("/dev/full").exists(), reason="needs /dev/full"
            ),
        ),
    ],
    ids=lambda arguments: " ".join(
        a if len(a) < 20 and a.isprintable() else "_" for a in arguments
    ),
)
def test_odd_paths_end_in_one_printable_line(capsys, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("knowarm: ")
    assert error.endswith("\n")
    assert error[:-1].isprintable()
