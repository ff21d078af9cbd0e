"""Tests of the command line: help, names and errors of every command."""

import dataclasses
import errno
import itertools
import json
import os
import re
import shlex
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from knowarm.cli.list import KINDS
from knowarm.cli.main import COMMANDS, DOORS, find_command, main, with_flags
from knowarm.cli.train import USAGE, Train
from knowarm.config import to_dict
from knowarm.errors import Argument, UserError
from knowarm.experiment.agents import AGENTS
from knowarm.experiment.run_folder import RunFolder
from knowarm.world.objects import TARGETS
from knowarm.world.robots import ROBOTS
from tests.tiny import short

ROOT = Path(__file__).parent.parent.parent
parse_train = partial(Train.parse, "knowarm train")


def run(capsys, *arguments: str) -> tuple[int, str, str]:
    code = main(arguments)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_help_lists_every_command(capsys):
    code, out, _ = run(capsys)
    assert code == 0
    assert all(name in out for name in [*COMMANDS, *DOORS])


def test_help_and_version_are_commands_and_train_needs_a_name(capsys):
    assert run(capsys, "help") == run(capsys, "--help")
    assert run(capsys, "version") == run(capsys, "--version")
    with pytest.raises(SystemExit) as ended:
        main(["train"])
    assert ended.value.code == 2
    assert "usage: knowarm train EXPERIMENT" in capsys.readouterr().err


def commands_in(group, *words):
    yield words
    if isinstance(group, dict):
        for name, command in group.items():
            yield from commands_in(command, *words, name)


def options_without_text(shown):
    """Return the options in a help that say no more than their values and default."""
    bare = []
    for option in re.split(r"\n *(?=--\w)", re.sub("[│╭╰╮╯─]", " ", shown))[1:]:
        block = re.split(r"\n *\n", option)[0]
        name, *words = re.sub(
            r"\(default:.*?\)|\(required\)|\{.*?\}", "", block
        ).split()
        if all(word.isupper() for word in words):
            bare.append(name)
    return bare


def test_every_command_has_a_help_with_a_text_for_each_option(capsys):
    for name in [*COMMANDS, *DOORS]:
        for words in commands_in(find_command(name), name):
            with pytest.raises(SystemExit) as ended:
                main([*words, "--help"])
            assert ended.value.code in (0, None), words
            shown = capsys.readouterr().out
            assert f"usage: knowarm {' '.join(words)}" in shown
            assert not options_without_text(shown), words


def test_a_typing_error_in_a_command_imports_nothing_heavy():
    heavy = "{'torch', 'numba', 'mujoco', 'scipy'} & set(sys.modules)"
    script = f"import sys; from knowarm.cli.main import main; main(['trian']); print({heavy})"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True
    )
    assert "Did you mean 'train'" in done.stderr
    assert done.stdout == "set()\n"


MISTYPED = [
    ["demo", "--step", "3"],
    ["train", "irb120-full-fast", "--totl-steps", "3"],
    ["train", "irb120-full-fast", "--policy.fusion", "flim"],
    ["evaluate", "oracle", "--epsiodes", "3"],
    ["view", "irb120", "--episods", "3"],
    ["doctor", "--robt", "x"],
    ["knowledge", "fit", "--vald", "3"],
]


def test_a_typing_error_in_an_option_does_not_import_torch():
    script = f"""
import contextlib, sys
from knowarm.cli.main import main
for words in {MISTYPED}:
    with contextlib.suppress(SystemExit):
        main(words)
    print(words[0], "torch" in sys.modules)
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True
    )
    assert done.stdout.split("\n") == [*(f"{words[0]} False" for words in MISTYPED), ""]
    assert "Did you mean 'film'" in done.stderr.replace("\n", " ")


@pytest.mark.parametrize("columns", ["80", "120"])
def test_help_of_train_shows_ten_options_a_group_or_all(capsys, monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", columns)

    def shown(*words):
        with pytest.raises(SystemExit):
            main(["train", "irb120-full-fast", *words])
        return re.findall(r"^[│ ] --(\w[\w.-]*)", capsys.readouterr().out, re.MULTILINE)

    first, group, everything = (
        shown("--help"),
        shown("--help", "env"),
        shown("--help-all"),
    )
    assert len(first) == 10
    # The group of the usage
    assert shown("--help", *re.findall(r"--help (\w+) ", USAGE))
    assert {"seed", "total-steps", "graph"} < set(first)
    assert all(name.startswith("env.") for name in group)
    assert len(shown("--help", "policy")) > 2
    assert len(group) < len(everything)
    assert {*first, *group} < set(everything)
    # Tags of alternatives
    assert not [name for name in everything if name.endswith(".kind")]
    assert main(["train", "irb120-full-fast", "--help", "polcy"]) == 2
    assert "Did you mean 'policy'" in capsys.readouterr().err


def test_help_of_evaluate_has_examples_and_no_subcommands(capsys):
    def shown(*words):
        with pytest.raises(SystemExit):
            main(["evaluate", *words])
        return capsys.readouterr().out

    first = shown("--help")
    assert "knowarm evaluate oracle --env.robot tiago --env.task choose" in first
    assert len(re.findall(r"^[│ ] --\w", first, re.MULTILINE)) == 11
    assert "env.randomization.light" in shown("oracle", "--help", "env.randomization")
    everything = shown("--help-all")
    assert "--repair" in everything
    assert "subcommand" not in everything


def test_options_of_train_come_from_a_file(tmp_path, capsys):
    file = tmp_path / "run.toml"
    file.write_text('total_steps = 6400\n[env]\ntargets = ["mug"]\n')
    words = ["irb120-full-fast", "--config", str(file)]
    assert parse_train(words).config.env.targets == ("mug",)
    assert parse_train([*words, "--total-steps", "3200"]).config.total_steps == 3200
    file.write_text("[algorithm]\nnum_env = 64\n")
    assert main(["train", *words]) == 2
    assert "'num_envs'" in capsys.readouterr().err


def test_a_file_changes_a_resumed_training_as_options_do(tmp_path, reach_run, copy_of):
    runs = copy_of(reach_run).path.parents[1]
    file = tmp_path / "run.toml"
    file.write_text("total_steps = 6400\n")
    words = ["irb120-full-ppo", "--runs", str(runs), "--resume", "--config", str(file)]
    assert parse_train(words).config == dataclasses.replace(short(), total_steps=6400)


def test_list_shows_and_writes_the_names(capsys, tmp_path):
    file = tmp_path / "names.json"
    code, out, _ = run(capsys, "list", "--json", str(file))
    assert code == 0
    assert all(f"knowarm list {kind}" in out for kind in KINDS if kind != "experiments")
    assert len(out.splitlines()) < 25
    for kind, every in (("robots", ROBOTS), ("agents", AGENTS), ("targets", TARGETS)):
        out = run(capsys, "list", kind)[1]
        assert all(name in out for name in every)
    names = json.loads(file.read_text())
    assert {"irb120", "tiago"} <= set(names["robots"])
    assert "irb120-full-a3c" in names["experiments"]
    assert names["targets"]["mug"] == ["red", "blue"]


def test_list_shows_one_kind_only(capsys):
    code, out, _ = run(capsys, "list", "targets")
    assert code == 0
    assert re.search("mug.*red, blue", out)
    assert "subgraph" not in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["trian"], ["Unknown command 'trian'", "'train'"]),
        (["train", "irb120-fulll-ppo"], ["Unknown agent", "'full'"]),
        (["train", "irb121-full-ppo"], ["Unknown robot", "'irb120'"]),
        (["train", "--seed", "1"], ["first argument"]),
        (["train", "irb120-bm-ppo", "--env.targets", "mgu"], ["mgu", "'mug'"]),
        (
            ["train", "irb120-bm-ppo", "--resume", "--runs", "nowhere"],
            ["no run to resume"],
        ),
        (["evaluate", "runs/none/0"], ["is not a run folder"]),
        (["evaluate", "orakle"], ["'oracle'"]),
        (["evaluate", "zero", "--json", "/proc/none/x.json"], ["--json"]),
        (["evaluate", "kitchen.csv"], ["it is no folder"]),
        (["evaluate", "runs/X"], ["Give a run, such as runs/X/0"]),
        (["list", "robot"], ["'robots'"]),
        (
            ["knowledge", "queries", "--graph", "empty.csv"],
            ["empty.csv holds no triples"],
        ),
        (
            ["train", "irb120-full-fast", "--graph", "kitchen.csv"],
            ["--knows.detail partial"],
        ),
        (["ask"], ["Give a question: knowarm ask 'something to drink from'"]),
        (
            ["ask", "--edit", "- mug usedFor tea", "usedFor drinking"],
            ["Give a question, before --edit and --names", "knowarm ask 'something"],
        ),
        (["study", "unpack", "kitchen.csv"], ["no pack of a study"]),
        (["train", "full-fast", "--env.robot", "arm.urdf"], ["is a model file"]),
        (
            ["doctor", "--robot", "arn.urdf"],
            ["there is no such file. Correct the path"],
        ),
        (["view", "arn.urdf"], ["There is no file 'arn.urdf'. Give the path"]),
        (["record", "zero"], ["Missing from knowarm record: --to DIR. `knowarm rec"]),
        (["knowledge", "shwo"], ["'show'"]),
        (["knowledge", "show", "--objects", "mgu"], ["mgu", "mug"]),
        (
            ["train", "irb120-bm-ppo", "--env.mpi-rad", "0"],
            ["mpi_rad must be larger than 0"],
        ),
        (
            ["train", "irb120-bm-ppo", "--algorithm.minibatches", "3"],
            ["must divide num_envs"],
        ),
        (
            ["evaluate", "zero", "--episodes", "0"],
            ["episodes must be at least 1, got 0"],
        ),
        (["ros", "none", "--max-steps", "0"], ["max_steps must be at least 1, got 0"]),
        (["train", "irb120-bm-ppo", *2 * ["--env.targets", "mug"]], ["is given twice"]),
        (["train", "irb120-bm-ppo", "--seed", "1", "--seed=2"], ["is given twice"]),
        (["knowledge", "show", *2 * ["--source", "zeros"]], ["is given twice"]),
        (
            ["evaluate", "zero", "--episodes", "many"],
            ["expected a whole number", "'many'"],
        ),
        (["evaluate", "zero", "--distance-m", "5cm"], ["expected a number", "'5cm'"]),
        (
            ["evaluate", "zero", "--epsiodes", "3"],
            ["Unrecognized", "Did you mean --episodes?"],
        ),
        (
            ["train", "irb120-bm-ppo", "--learning-rate", "3"],
            ["Did you mean --algorithm.learn"],
        ),
        (
            ["evaluate", "zero", "--split", "S9"],
            ["Unknown value of --split 'S9'", "S1, S2, S3,"],
        ),
        (["evaluate", "zero", "--split"], ["Missing value", "knowarm evaluate --help"]),
        (
            ["evaluate"],
            ["Missing from knowarm evaluate: AGENT. `knowarm evaluate --help`"],
        ),
        (["train", "irb120-bm-ppo", "--env.mpi-rad", "x"], ["expected FLOAT, got 'x'"]),
        (["train", "irb120-bm-ppo", "--name", ""], ["got ''"]),
        (
            ["evaluate", "runs/X/0", "--env.robot", "irb120"],
            ["A run has its own environment"],
        ),
        (["view", "runs/X/0"], ["is a run: knowarm view --agent runs/X/0"]),
    ],
)
def test_mistakes_end_in_one_line_and_code_2(
    capsys, tmp_path, monkeypatch, arguments, words
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "kitchen.csv").write_text("mug,usedFor,drinking\n")
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "arm.urdf").write_text("<robot/>")
    (tmp_path / "runs" / "X" / "0").mkdir(parents=True)
    (tmp_path / "runs" / "X" / "0" / "config.json").write_text("{}")
    before = sorted(tmp_path.rglob("*"))
    code, _, err = run(capsys, *arguments)
    assert code == 2, err
    assert err.startswith("knowarm: ")
    assert err.count("\n") == 1
    for word in words:
        assert word in err
    assert sorted(tmp_path.rglob("*")) == before  # nothing half-written


def test_a_mistake_ends_in_one_line_on_a_terminal_with_colours(capsys, monkeypatch):
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    _, _, err = run(capsys, "evaluate", "zero", "--epsiodes", "3")
    assert err.startswith(
        "knowarm: Unrecognized options: --epsiodes, 3. Did you mean --episodes?"
    )
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        RuntimeError("can't allocate memory: you tried to allocate 160480360000 bytes"),
        RuntimeError("CUDA out of memory. Tried to allocate 9.31 GiB."),
        OSError(errno.EMFILE, "Too many open files"),
        ImportError("libtorch_cpu.so: failed to map segment from shared object"),
    ],
    ids=lambda e: f"{e!r}",
)
def test_limits_of_the_machine_end_in_one_line(capsys, monkeypatch, error):
    def run(command):
        raise error

    monkeypatch.setattr("knowarm.cli.list.List.run", run)
    assert main(["list"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows has no limits")
@pytest.mark.parametrize("kind", ["RLIMIT_AS", "RLIMIT_DATA"])
@pytest.mark.parametrize("megabytes", [30, 60, 100, 150, 200, 300, 400, 500])
def test_too_little_memory_for_libraries_is_one_line(kind, megabytes):
    code = (
        f"import resource, runpy; size = {megabytes} << 20\n"
        f"resource.setrlimit(resource.{kind}, (size, size))\n"
        "runpy.run_module('knowarm', run_name='__main__')"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert f"memory is limited to {(megabytes << 20) // 10**6} MB" in done.stderr


def test_integers_may_be_written_as_floats():
    options = ["--total-steps", "1e5", "--algorithm.epochs=2"]
    config = parse_train(["irb120-bm-ppo", *options]).config
    assert (config.total_steps, config.algorithm.epochs) == (100_000, 2)
    with pytest.raises(UserError, match=r"1\.5e0"):
        parse_train(["irb120-bm-ppo", "--total-steps", "1.5e0"])


@pytest.mark.parametrize(
    "shell",
    [
        'mkdir gone && cd gone && rmdir ../gone && exec "$@"',
        'exec "$@" 1</dev/null',
        'NUMBA_NUM_THREADS=0 exec "$@"',
    ],
)
def test_an_environment_that_does_not_work_ends_in_one_line(tmp_path, shell):
    command = [
        "bash",
        "-c",
        shell,
        "bash",
        sys.executable,
        "-m",
        "knowarm",
        "list",
        "agents",
    ]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    # What is imported decides whether the folder matters
    assert done.returncode in (
        0,
        2,
    )
    assert done.stderr.count("\n") == done.returncode // 2


def test_characters_that_the_output_lacks_are_replaced(tmp_path):
    environment = {**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}
    script = "from knowarm.cli.main import main; main(['version']); print('20\\N{DEGREE SIGN}')"
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stderr) == (0, "")
    assert "20?" in done.stdout


def test_an_unwritable_runs_folder_is_found_before_training(capsys, tmp_path):
    (tmp_path / "file").write_text("")
    code, _, err = run(
        capsys, "train", "irb120-bm-ppo", "--runs", str(tmp_path / "file")
    )
    assert code == 2
    assert re.search("Cannot write .*: Not a directory. Pass another folder", err)


def test_evaluate_prints_and_writes_the_table(capsys, tmp_path):
    file = tmp_path / "table.json"
    code, out, _ = run(
        capsys, "evaluate", "oracle", "--episodes", "6", "--json", str(file)
    )
    assert code == 0
    table = json.loads(file.read_text())
    assert {"return_mean", "accuracy", "success", "length_mean"} <= set(
        table["numbers"]
    )
    assert table["numbers"]["episodes"] == 6
    assert "success" in out


def test_errors_of_the_library_name_flags() -> None:
    pan = Argument("knows.aliases", {"sauce pan": "pan"})
    error = UserError(
        "Pass ", Argument("resume", True), " or ", Argument("save", False)
    )
    assert str(error) == "Pass resume=True or save=False"
    assert with_flags(error, "study") == "Pass --resume or --no-save"
    error = UserError("Use ", Argument("knows.detail", "full"), " or ", pan)
    assert (
        with_flags(error, "study")
        == "Use detail='full' or aliases={'sauce pan': 'pan'}"
    )
    assert (
        with_flags(error, "knowledge")
        == "Use --detail full or --aliases 'sauce pan' pan"
    )
    assert with_flags(error, "train") == (
        "Use --knows.detail full or --knows.aliases 'sauce pan' pan"
    )


def test_a_knowledge_source_is_chosen_by_name() -> None:
    command = parse_train(["irb120-full-ppo", "--knows.source", "zeros"])
    assert to_dict(command.config)["knows"]["source"]["kind"] == "zeros"


AT_EXIT = """
import atexit, sys
from knowarm.cli.main import main

class Last:
    def __del__(self):
        print("freed")

last = Last()
atexit.register(print, "at exit")
sys.argv = ["knowarm", *sys.argv[1:]]
main()
"""


@pytest.mark.parametrize(
    ("argument", "code", "out"), [("--version", 0, 1), ("fly", 2, 0)]
)
def test_a_command_ends_without_freeing_its_objects(argument, code, out) -> None:
    """With PyTorch loaded this took a second, and 12 on a machine with other programs."""
    done = subprocess.run(
        [sys.executable, "-c", AT_EXIT, argument], capture_output=True, text=True
    )
    assert done.returncode == code
    assert len(done.stdout.splitlines()) == out + 1
    assert done.stdout.endswith("at exit\n")
    assert done.stderr.count("\n") == 1 - out


def test_make_best_is_the_recipe_of_the_shipped_policy() -> None:
    done = subprocess.run(
        ["make", "--no-print-directory", "-n", "best"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    commands = done.stdout.replace("\\\n", " ").splitlines()
    train = next(line for line in commands if " -m knowarm train " in line)
    arguments = shlex.split(train.split(" train ")[1])
    config = to_dict(
        parse_train([word for word in arguments if word != "--resume"]).config
    )
    shipped = to_dict(RunFolder.open(ROOT / "zoo" / "irb120-full-fast").experiment())
    # The number of processes depends on the machine; it changes the rounding only.
    for values in (config, shipped):
        del values["algorithm"]["processes"]
    assert config == shipped


def test_evaluate_and_record_take_a_task_by_name(tmp_path, capsys):
    options = ["--episodes", "2"]
    assert main(["evaluate", "oracle", "--env.task", "choose", *options]) == 0
    assert "right choices" in capsys.readouterr().out
    assert (
        main(
            [
                "record",
                "oracle",
                "--env.task",
                "choose",
                *options,
                "--to",
                str(tmp_path / "d"),
            ]
        )
        == 0
    )
    assert main(["record", "oracle", "--seed", "-1", "--to", str(tmp_path / "e")]) == 2
    assert "seed must lie between 0 and 2**63 - 1, got -1" in capsys.readouterr().err
    assert main(["evaluate", "oracle", "--env.task", "chose"]) == 2
    assert "'choose'" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", ["ask", "study run", "doctor", "view", "train --help-all"]
)
def test_the_help_of_every_command_has_one_face(capsys, monkeypatch, words):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        main([*words.replace("train", "train irb120-full-fast").split(), "--help"])
    shown = re.sub("[│╭╰╮╯─]", " ", capsys.readouterr().out)
    assert "-h, --help" in shown
    assert not re.findall(
        r"None\}|default: (?:None|False)?\)|--[\w.-]*kind|--no-dry-run", shown
    )
    lines = shown.splitlines()
    for line, after in itertools.pairwise(
        lines
    ):  # sentences are broken at the right margin only
        if after.strip() and all(each.startswith(" " * 14) for each in (line, after)):
            assert len(line.rstrip()) + 1 + len(after.split()[0]) > 76, line
