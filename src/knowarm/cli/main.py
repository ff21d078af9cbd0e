"""Entry point of the command line: runs one command and returns its exit code.

Only the module of the given command is imported, so that help and typing errors answer at once.
"""

import errno
import io
import os
import re
import shlex
import sys
from collections.abc import Sequence
from contextlib import redirect_stderr
from importlib import import_module
from typing import Any

import knowarm
from knowarm.cli.arguments import OWN, group_help, parse_command, take_option
from knowarm.errors import UserError, printable, unknown_name
from knowarm.private_apis import end_process

COMMANDS = {
    "demo": ("train:Demo", "train two agents for a short time, evaluate them, write a report"),
    "list": ("list:List", "list robots, targets, agents, algorithms and experiments"),
    "train": ("train:parse_train", "train one agent, or resume a stopped run"),
    "evaluate": ("evaluate:Evaluate", "evaluate a trained or scripted agent on fixed episodes"),
    "ask": ("ask:Ask", "ask a trained agent a question that a graph answers"),
    "study": ("study:COMMANDS", "run a table of experiments and seeds, restartable"),
    "report": ("study:Report", "write one HTML report from run folders"),
    "perception": ("train:PERCEPTION", "train a module that names objects and colours"),
    "knowledge": ("knowledge:COMMANDS", "inspect a graph, its sentences, vectors and embeddings"),
    "view": ("view:View", "show an agent in the browser, or record it"),
    "export": ("deploy:Export", "write a trained policy as ONNX, with contract and runner"),
    "serve": ("deploy:Serve", "serve a trained policy to robots over WebSocket (openpi)"),
    "ros": ("deploy:Ros", "drive a robot over ROS 2, with safety rules before every motion"),
    "record": ("deploy:Record", "record episodes as a LeRobot dataset"),
    "hub": ("deploy:HUB", "share policies and studies on the Hugging Face Hub"),
    "benchmark": ("benchmark:COMMANDS", "score any policy on frozen episodes, beside controls"),
    "bench": ("bench:Bench", "measure the speed of this machine"),
    "doctor": ("doctor:Doctor", "check this installation, or a robot of your own"),
}
"""Where each command is defined, and its help text.

The definition is a frozen dataclass whose fields are the arguments and whose ``run()`` does the
work and may return an exit code, a function that makes one from the arguments, or a dict of such
definitions by name.
"""

FULL_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EIO)  # system errors without the name of a file


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return 0, 2 for a user error or 130 after Ctrl-C; exit without ``argv``."""
    if argv is None:
        end_process(_run(sys.argv[1:]))
    return _run(list(argv))


def _run(arguments: list[str]) -> int:
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # characters that its encoding lacks
    try:
        if not arguments or arguments[0] in ("-h", "--help"):
            about = "Deep reinforcement learning of robot-arm policies with knowledge graphs."
            summaries = {name: what for name, (_, what) in COMMANDS.items()}
            print(group_help("knowarm", about, summaries))
        elif arguments[0] == "--version":
            print(f"knowarm {knowarm.__version__}")
        else:
            code = _parse(arguments[0], arguments[1:]).run()
            return code if isinstance(code, int) else 0
    except UserError as error:
        return _fail(with_flags(str(error), *arguments[:1]))
    except KeyboardInterrupt:
        print("knowarm: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader (head, less) has closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        if error.filename is None and error.errno not in FULL_DISK:
            raise
        where = str(error.filename or "A file")
        where = where if len(where) <= 100 else f"{where[:97]}..."
        return _fail(f"{where}: {error.strerror}. Give another path, or free disk space.")
    return 0


def _fail(message: str) -> int:
    """Print an error on one line and return 2."""
    print(f"knowarm: {printable(message)}", file=sys.stderr)
    return 2


def with_flags(message: str, command: str = "") -> str:
    """Replace arguments in an error message by flags: ``resume=True`` becomes ``--resume``.

    In `knowarm train` and `knowarm knowledge` also ``detail='full'`` and ``aliases={'a': 'b'}``.
    """

    def flag(found: re.Match[str]) -> str:
        name, value = found[1], found[2]
        if value[0] in "{'":
            from knowarm.knowledge.config import KnowledgeConfig
            from knowarm.policy.config import PolicyConfig
            from knowarm.world.config import EnvConfig

            groups: dict[str, Any] = {
                "knowledge": KnowledgeConfig,
                "env": EnvConfig,
                "policy": PolicyConfig,
            }
            places = [group for group, of in groups.items() if name in of.__dataclass_fields__]
            if command not in ("train", "knowledge") or not places:
                return found[0]
            name = f"{places[0]}.{name}" if command == "train" else name
            value = shlex.join(re.findall("'(.+?)'", value))
        name = name.replace("_", "-")
        return {"True": f"--{name}", "False": f"--no-{name}"}.get(value, f"--{name} {value}")

    value = r"True\b|False\b|FILE\b|'[^']+'|\{'[^']+': '[^']+'\}"
    return re.sub(rf"\b([a-z_]+)=({value})", flag, message)


def _parse(name: str, arguments: list[str]) -> Any:
    """Return the command with its arguments, ready to run."""
    if name not in COMMANDS:
        raise unknown_name("command", name, COMMANDS)
    for flag, (_, register) in OWN.items():
        arguments, place = take_option(arguments, flag, "package.module:Name")
        if place is not None:
            register(place)
    where, about = COMMANDS[name]
    module, _, attribute = where.partition(":")
    command = getattr(import_module(f"knowarm.cli.{module}"), attribute)
    told = io.StringIO()
    try:
        with redirect_stderr(told):
            return parse_command(
                command, f"knowarm {name}", f"{about[0].upper()}{about[1:]}.", arguments
            )
    except SystemExit:  # tyro frames what classes of grouped options refuse
        words = " ".join(line.strip("│╭╮╰╯─ ") for line in told.getvalue().splitlines())
        if refused := re.search(r"Error parsing [\w.]+: (.+?) +For full helptext", words):
            told.truncate(0)
            raise UserError(refused[1]) from None
        raise
    finally:
        sys.stderr.write(told.getvalue())
