"""Entry point of the command line: runs one command and returns its exit code.

Only the module of the given command is imported, so that help and typing errors answer at once.
"""

import errno
import os
import re
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import tyro

import knowarm
from knowarm.errors import UserError, unknown_name
from knowarm.private_apis import end_process

COMMANDS = {
    "demo": ("train:Demo", "train two agents for a short time, evaluate them, write a report"),
    "list": ("list:List", "list robots, targets, agents, algorithms and experiments"),
    "train": ("train:parse_train", "train one agent, or resume a stopped run"),
    "evaluate": ("evaluate:Evaluate", "evaluate a trained or scripted agent on fixed episodes"),
    "study": ("study:COMMANDS", "run a table of experiments and seeds, restartable"),
    "report": ("report:Report", "write one HTML report from run folders"),
    "perception": ("perception:parse", "train a module that names objects and colours in images"),
    "knowledge": ("knowledge:parse", "inspect a graph, its sentences, vectors and embeddings"),
    "view": ("view:View", "show an agent in the browser, or record it"),
    "export": ("report:Export", "write a trained policy as ONNX"),
    "bench": ("bench:COMMANDS", "measure the speed of this machine"),
    "doctor": ("doctor:Doctor", "check this installation, or a robot of your own"),
}
"""Where each command is defined, and its help text.

The definition is a frozen dataclass whose fields are the arguments and whose ``run()`` does the
work, a dict of such dataclasses by name, or a function that makes one from the arguments.
"""

FULL_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EIO)
"""Errors of the system without the name of a file."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: arguments after the program's name; None takes them from ``sys.argv``.

    Returns:
        0, or 2 for a user error, or 130 after Ctrl-C. Without ``argv`` the process ends with it.
    """
    if argv is None:
        end_process(_run(sys.argv[1:]))
    return _run(list(argv))


def _run(arguments: list[str]) -> int:
    """Run one command and return the exit code."""
    try:
        if not arguments or arguments[0] in ("-h", "--help"):
            print(_help())
        elif arguments[0] == "--version":
            print(f"knowarm {knowarm.__version__}")
        else:
            _parse(arguments[0], arguments[1:]).run()
    except UserError as error:
        return _fail(with_flags(str(error)))
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # the reader (head, less) has closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        if error.filename is None and error.errno not in FULL_DISK:
            raise
        where = str(error.filename or "A file")
        shown = where if len(where) <= 100 else f"{where[:97]}..."
        return _fail(f"{shown}: {error.strerror}. Give another path, or free disk space.")
    return 0


def _fail(message: str) -> int:
    """Print an error on one line, control characters of names from files escaped; return 2."""
    shown = "".join(
        each if each.isprintable() else each.encode("unicode_escape").decode() for each in message
    )
    print(f"knowarm: {shown}", file=sys.stderr)
    return 2


def with_flags(message: str) -> str:
    """Replace boolean arguments in an error message of the library by flags.

    ``resume=True`` becomes ``--resume``, ``matched_only=False`` becomes ``--no-matched-only``, and
    ``perception=FILE`` becomes ``--perception FILE``.
    """

    def flag(found: re.Match[str]) -> str:
        name, value = found.groups()
        if value == "FILE":
            return f"--{name.replace('_', '-')} FILE"
        return f"--{'' if value == 'True' else 'no-'}{name.replace('_', '-')}"

    return re.sub(r"\b([a-z_]+)=(True|False|FILE)\b", flag, message)


def _parse(name: str, arguments: list[str]) -> Any:
    """Return the command with its arguments, ready to run."""
    if name not in COMMANDS:
        raise unknown_name("command", name, COMMANDS)
    where, description = COMMANDS[name]
    module, _, attribute = where.partition(":")
    command = getattr(import_module(f"knowarm.cli.{module}"), attribute)
    prog = f"knowarm {name}"
    if isinstance(command, type):
        return tyro.cli(command, prog=prog, args=arguments)
    if not isinstance(command, dict):
        return command(arguments)
    if arguments and not arguments[0].startswith("-") and arguments[0] not in command:
        raise unknown_name(f"{name} command", arguments[0], command)
    return tyro.extras.subcommand_cli_from_dict(
        command, prog=prog, description=f"{description.capitalize()}.", args=arguments
    )


def _help() -> str:
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {what}" for name, (_, what) in COMMANDS.items()]
    return "\n".join(
        [
            "usage: knowarm COMMAND [ARGUMENTS]",
            "",
            "Deep reinforcement learning of robot-arm policies with knowledge graphs.",
            "",
            "commands:",
            *lines,
            "",
            "`knowarm COMMAND --help` shows a command's arguments.",
        ]
    )
