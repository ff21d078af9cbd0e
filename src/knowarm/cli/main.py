"""Entry point of the command line: runs one command and returns its exit code.

Only the module of the given command is imported, so that help and typing errors answer at once.
"""

import io
import os
import shlex
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib import import_module
from importlib.metadata import version
from typing import Any

from knowarm.cli.arguments import HELP, OWN, parse_options, take_option
from knowarm.config import check_values
from knowarm.errors import Argument, DataWarning, UserError, printable, unknown_name
from knowarm.private_apis import end_process
from knowarm.reading import one_line
from knowarm.world.description import trust

COMMANDS = {
    "demo": (
        "train:Demo",
        "train two agents for a short time, evaluate them, write a report",
    ),
    "list": ("list:List", "list robots, targets, agents, algorithms and experiments"),
    "train": ("train:Train", "train one agent, or resume a stopped run"),
    "evaluate": (
        "evaluate:Evaluate",
        "evaluate a trained or scripted agent on fixed episodes",
    ),
    "study": ("study:COMMANDS", "run a table of experiments and seeds, restartable"),
    "report": ("study:Report", "write one HTML report from run folders"),
    "figure": ("study:PaperFigure", "write a figure or table of runs for a paper"),
    "knowledge": (
        "knowledge:COMMANDS",
        "inspect a graph, its sentences, vectors and embeddings",
    ),
    "view": ("view:View", "show an agent in the browser, or record it"),
    "hub": ("hub:HUB", "share policies and studies on the Hugging Face Hub"),
}
"""Where each command of the core is defined, below ``knowarm.cli``, and its help text.

The definition is a frozen dataclass whose fields are the arguments and whose ``run()`` does the
work and may return an exit code, or a dict of such definitions by name.
"""

DOORS = {
    "ask": (
        "asking.command:Ask",
        "ask a trained agent a question that a graph answers",
    ),
    "answer": (
        "asking.command:AnswerCommand",
        "answer a question about objects by a graph alone",
    ),
    "tidy": (
        "asking.tidying.command:Tidy",
        "let a trained agent bring things to where a graph says they belong",
    ),
    "export": (
        "deploy.command:Export",
        "write a trained policy as ONNX, with contract and runner",
    ),
    "serve": (
        "deploy.command:Serve",
        "serve a trained policy to robots over WebSocket (openpi)",
    ),
    "ros": (
        "deploy.command:Ros",
        "drive a robot over ROS 2, with safety rules before every motion",
    ),
    "record": ("deploy.command:Record", "record episodes as a LeRobot dataset"),
    "benchmark": (
        "benchmark.command:COMMANDS",
        "score any policy on frozen episodes, beside controls",
    ),
    "doctor": (
        "own_robot.command:Doctor",
        "check this installation, or a robot of your own",
    ),
}
"""The same for the commands of the packages above the core, below ``knowarm``.

The core never imports one of them but for its command.
"""


ALL = COMMANDS | DOORS
"""Every command, by name."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return 0, 2 for a user error or 130 after Ctrl-C; exit without ``argv``."""
    if argv is None:
        end_process(_run(sys.argv[1:]))
    return _run(list(argv))


def _run(arguments: list[str]) -> int:
    with warnings.catch_warnings():  # restores what shows them
        warnings.simplefilter("default", DataWarning)
        warnings.showwarning = partial(_show_warning, warnings.showwarning)
        return _run_command(arguments)


def _run_command(arguments: list[str]) -> int:
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # characters that its encoding lacks
    try:
        if not arguments or arguments[0] in ("-h", "--help", "help"):
            about = "Deep reinforcement learning of robot-arm policies with knowledge graphs."
            summaries = {name: what for name, (_, what) in ALL.items()}
            print(_group_help("knowarm", about, summaries))
        elif arguments[0] in ("--version", "version"):
            print(f"knowarm {version('knowarm')}")
        else:
            code = _parse(arguments[0], arguments[1:]).run()
            return code if isinstance(code, int) else 0
    except UserError as error:
        return _fail(with_flags(error, *arguments[:1]))
    except KeyboardInterrupt:
        print("knowarm: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader (head, less) has closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except ImportError as error:
        if "shared object" not in str(error):
            raise
        return _fail(f"{one_line(error)}. Raise the limit of memory (ulimit -a).")
    except (MemoryError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and "allocate" not in str(error):
            raise  # no error of PyTorch for memory
        return _fail("The memory of this machine is not enough: give smaller numbers.")
    except OSError as error:  # of files, full disks, closed streams and limits
        where = str(error.filename or "The system refuses")
        return _fail(
            f"{where:.100}: {error.strerror or error}. Give another path or output, start in an "
            "existing folder, free disk space, or raise a limit (ulimit -a)."
        )
    return 0


def _show_warning(
    show: Callable[..., None],
    message: Any,
    category: Any,
    *where: Any,
) -> None:
    """Print a warning of a user's file on one line, and any other as Python does."""
    if category is DataWarning:
        print(f"knowarm: warning: {printable(str(message))}", file=sys.stderr)
    else:
        show(message, category, *where)


def _fail(message: str) -> int:
    """Print an error on one line and return 2."""
    print(f"knowarm: {printable(message)}", file=sys.stderr)
    return 2


def with_flags(error: UserError, command: str = "") -> str:
    """Return the message of an error with options for the arguments that are its parts.

    Only `knowarm train` and `knowarm knowledge` have options for parts of an experiment's config.
    """
    words = [
        _flag(part, command) if isinstance(part, Argument) else part
        for part in error.args
    ]
    return "".join(map(str, words))


def _flag(argument: Argument, command: str) -> str:
    group, _, name = argument.name.rpartition(".")
    if group and command not in ("train", "knowledge"):
        return str(argument)
    name = (argument.name if command == "train" else name).replace("_", "-")
    value = argument.value
    if isinstance(value, bool):
        return f"--{name}" if value else f"--no-{name}"
    words = [*value, *value.values()] if isinstance(value, dict) else [str(value)]
    return shlex.join([f"--{name}", *words])


def _parse(name: str, arguments: list[str]) -> Any:
    """Return the command with its arguments, ready to run."""
    # Who names a description in a command trusts it; those that files name are checked.
    trust([word.rpartition("=")[2] for word in arguments])
    if name not in ALL:
        raise unknown_name("command", name, ALL)
    for flag, (_, register) in OWN.items():
        arguments, import_path = take_option(arguments, flag, "package.module:Name")
        if import_path is not None:
            register(import_path)
    command = find_command(name)
    _, about = ALL[name]
    return _make_command(
        command, f"knowarm {name}", f"{about[0].upper()}{about[1:]}.", arguments
    )


def _make_command(command: Any, prog: str, about: str, arguments: Sequence[str]) -> Any:
    """Make a command from the words after its name ``prog``; ``about`` is the help of a group.

    ``command`` is a dataclass whose fields are the options, which may have a method ``parse``, or a
    group of these by name.
    """
    if isinstance(command, type):
        parse = getattr(command, "parse", partial(parse_options, command))
        made = parse(prog, arguments)
        check_values(made, where=prog.split()[-1])
        return made
    name, *words = arguments or ["--help"]
    if name in HELP:
        summaries = {}
        for name, member in command.items():
            summaries[name] = (member.__doc__ or "").partition("\n")[0]
        print(_group_help(prog, about, summaries))
        sys.exit(0)
    if name not in command:
        raise unknown_name(f"{prog.split()[-1]} command", name, command)
    return _make_command(command[name], f"{prog} {name}", "", words)


def _group_help(prog: str, about: str, commands: Mapping[str, str]) -> str:
    """Return the help text of a group of commands with their summaries."""
    width = max(map(len, commands))
    lines = [f"usage: {prog} COMMAND [ARGUMENTS]", "", about, "", "commands:"]
    for name, summary in commands.items():
        lines.append(f"  {name:<{width}}  {summary}")
    lines += ["", f"`{prog} COMMAND --help` shows a command's arguments."]
    return "\n".join(lines)


def find_command(name: str) -> Any:
    """Import what defines a command of ``COMMANDS`` or ``DOORS``.

    Raises:
        UserError: it is a door's, and the door is not installed.
    """
    module, _, attribute = ALL[name][0].partition(":")
    package = "knowarm.cli" if name in COMMANDS else "knowarm"
    door = f"knowarm.{module.partition('.')[0]}"
    try:
        return getattr(import_module(f"{package}.{module}"), attribute)
    except ModuleNotFoundError as error:
        if error.name != door:
            raise
        raise UserError(
            f"`knowarm {name}` is not installed here: it needs {door}."
        ) from None
