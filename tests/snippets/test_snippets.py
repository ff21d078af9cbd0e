"""Every command and code block of the documentation runs, page by page, shortened.

A page runs in a folder of its own. Comments in the page say what the reader has or does not need:

    <!-- snippets: first COMMAND -->   what the reader has done or has at hand
    <!-- snippets: file NAME -->       the next block is this file
    <!-- snippets: in FOLDER -->       the next block is Python run in this folder
    <!-- snippets: skip REASON -->     the next block is not run
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.source_tree import ROOT

FOLDERS = ("tutorials", "how-to", "reference")
GUIDES = sorted(
    path for folder in FOLDERS for path in (ROOT / "docs" / folder).glob("*.md")
)
PAGES = [
    *(
        "README.md",
        "docs/index.md",
        "docs/faq.md",
        "docs/reliability.md",
        "docs/results/README.md",
    ),
    *(path.relative_to(ROOT).as_posix() for path in GUIDES),
]
PARTS = re.compile(
    r"^<!-- snippets: (\w+) (.*?) -->|^```([^\n`]*)\n(.*?)^```",
    re.MULTILINE | re.DOTALL,
)
COMMAND = re.compile(r"(?:knowarm|sed|export) |python (?:examples/|-m benchmarks\.)")
SHORT = [
    (r"^knowarm train .*", "--total-steps 1600 --interim.episodes 2"),
    (r"^knowarm train (?!.*-a2c)", "--algorithm.processes 1 --algorithm.minibatches 1"),
    (
        r"^knowarm train .*-choose-(?!bm)",
        "--knows.grounding.images 500 --knows.grounding.rounds 1",
    ),
    (r"^knowarm train .*", "--algorithm.num-envs 32"),
    (r"^knowarm evaluate (?!.*--episodes)", "--episodes 10"),
    (r"^knowarm evaluate ", "--blind-episodes 4"),
    (r"^knowarm record ", "--episodes 2"),
    (r"^knowarm demo", "--steps 1600"),
    (r"^knowarm view (?!.*(--strip|--video|--rrd))", "--episodes 1 --no-browser"),
    (r"^python -m benchmarks.speed", "--seconds .1"),
    (r"^knowarm benchmark run .*my_policy:", "--cells irb120-fixed"),
    (r"^knowarm benchmark run (?!.*my_policy:)", "--trial 4"),
    (r"^python examples/(train_with_sb3|benchmark/train_sb3).py", "--steps 640"),
]
"""Options that shorten commands, in place of those that a command has."""
ENDLESS = r"^knowarm (serve|ask --browser)"


def shorten(command):
    """Return a command that does the same in less time."""
    command = command.partition("  #")[0].strip()
    for pattern, options in SHORT:
        if re.search(pattern, command):
            for option in re.findall(r"--\S+", options):
                command = re.sub(rf" {option} \S+", "", command)
            command = f"{command} {options}"
    return command


def commands(block):
    """Yield the commands of a block: after a prompt, or, without one, at the start of a line."""
    lines = block.replace("\\\n", " ").splitlines()
    prompted = [line[2:] for line in lines if line.startswith("$ ")]
    yield from prompted or [line for line in lines if COMMAND.match(line)]


def test_commands_are_found_and_shortened():
    assert list(commands("$ knowarm list\noutput")) == ["knowarm list"]
    assert list(commands("knowarm train a \\\n  --seed 1\nTrained for 3")) == [
        "knowarm train a    --seed 1"
    ]
    assert (
        shorten("knowarm record oracle --episodes 1000 --to x")
        == "knowarm record oracle --to x --episodes 2"
    )


@pytest.mark.parametrize("page", PAGES)
def test_the_snippets_of_a_page_run(page, tmp_path):
    for name in ("zoo", "examples", "benchmarks", "docs"):
        (tmp_path / name).symlink_to(ROOT / name)
    where = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": where, "COLUMNS": "80"}

    def run(command, where=tmp_path, **options):
        done = subprocess.run(
            command,
            cwd=where,
            env=environment,
            capture_output=True,
            text=True,
            timeout=900,
            **options,
        )
        shown = f"{command}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
        return done.returncode, shown

    script, mark = "", ("", "")
    for kind, value, language, block in PARTS.findall(
        (ROOT / page).read_text(encoding="utf-8")
    ):
        if kind == "first":
            code, shown = run(shorten(value), shell=True)
            assert code == 0, shown
        elif kind:
            mark = (kind, value)
        elif mark[0] == "file":
            (tmp_path / mark[1]).write_text(block)
            mark = ("", "")
        elif mark[0] == "skip":
            mark = ("", "")
        elif mark[0] == "in":
            (tmp_path / mark[1] / "script.py").write_text(block)
            code, shown = run([sys.executable, "script.py"], tmp_path / mark[1])
            assert code == 0, shown
            mark = ("", "")
        elif language == "python":
            script += (
                re.sub(r"(total_(?:time)?steps=)[\d_]+", r"\g<1>1600", block) + "\n"
            )
            (tmp_path / "script.py").write_text(script)
            code, shown = run([sys.executable, "script.py"])
            assert code == 0, shown
        elif language in ("", "sh"):
            for command in commands(block):
                short = shorten(command)
                if found := re.match(r"export (\w+)=(.*)", short):
                    environment[found[1]] = found[2].replace("$PWD", str(tmp_path))
                    continue
                endless = re.match(ENDLESS, short)
                code, shown = run(
                    f"timeout -s INT 20 {short}" if endless else short, shell=True
                )
                assert code in ((124, 130) if endless else (0,)), shown
