"""Words of the command line go in; the command runs, and its exit code comes out.

Only the module of the command that was asked for is imported, so that help and typing errors
answer at once. Such a module offers one of:

- ``COMMAND``: a frozen dataclass whose fields are the arguments and whose ``run()`` does the work;
- ``COMMANDS``: a dict of such dataclasses, for a group of commands;
- ``parse(arguments)``: returns the dataclass, where the arguments depend on one another.
"""

import os
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import tyro

import knowarm
from knowarm.errors import UserError, unknown_name

COMMANDS = {
    "demo": "train two small agents, evaluate them and write a report",
    "list": "show the robots, agents, algorithms and experiments there are",
    "train": "train one agent, or go on with a stopped run",
    "evaluate": "play fixed episodes with a trained or scripted agent and print the table",
    "report": "write one HTML report from run folders",
    "knowledge": "look at a graph, its sentences, vectors and embeddings",
    "view": "watch an agent in the browser, or record it",
    "export": "write a trained policy as ONNX",
    "bench": "measure this machine",
    "doctor": "check this installation, or a robot of your own",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: the words after the program's name; None takes them from the process.

    Returns:
        0, or 2 for a mistake the user can mend, or 130 after Ctrl-C.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        if not arguments or arguments[0] in ("-h", "--help"):
            print(_help())
        elif arguments[0] == "--version":
            print(f"knowarm {knowarm.__version__}")
        else:
            _parse(arguments[0], arguments[1:]).run()
    except UserError as error:
        print(f"knowarm: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # the reader (head, less) has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def _parse(name: str, arguments: list[str]) -> Any:
    if name not in COMMANDS:
        raise unknown_name("command", name, COMMANDS)
    module = import_module(f"knowarm.cli.{name}")
    prog = f"knowarm {name}"
    if hasattr(module, "parse"):
        return module.parse(arguments)
    if hasattr(module, "COMMANDS"):
        if arguments and not arguments[0].startswith("-") and arguments[0] not in module.COMMANDS:
            raise unknown_name(f"{name} command", arguments[0], module.COMMANDS)
        return tyro.extras.subcommand_cli_from_dict(
            module.COMMANDS, prog=prog, description=COMMANDS[name], args=arguments
        )
    return tyro.cli(module.COMMAND, prog=prog, args=arguments)


def _help() -> str:
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {what}" for name, what in COMMANDS.items()]
    return "\n".join(
        [
            "usage: knowarm COMMAND ...",
            "",
            "Commonsense for robot-arm policies.",
            "",
            *lines,
            "",
            "`knowarm COMMAND --help` shows a command's arguments.",
        ]
    )
