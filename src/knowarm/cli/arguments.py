"""Parsing of the command line: groups of commands, options, and names that come first."""

import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout, suppress
from functools import partial
from io import BytesIO, TextIOWrapper
from shutil import get_terminal_size
from textwrap import fill, indent, wrap
from typing import TYPE_CHECKING, Any, TypeVar

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from knowarm.errors import UserError, unknown_name
from knowarm.experiment import algorithms
from knowarm.world import tasks

if TYPE_CHECKING:
    from knowarm.knowledge.vectors import VectorSource

Command = TypeVar("Command")
HELP = ("-h", "--help")
WIDEST = 120  # columns of a help text; from 130 on tyro sets two side by side
OWN: dict[str, tuple[str, Callable[[str], Any]]] = {
    "--tasks": (tasks.VARIABLE, tasks.register_task),
    "--algorithms": (algorithms.VARIABLE, algorithms.register_algorithm),
}
"""Options of every command that import a part of your own: variable that does too, and how."""
REGISTRY = ConstructorRegistry()
"""Rules by which values of options are read, beside tyro's own."""


@REGISTRY.primitive_rule
def _integer(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[int] | None:
    """Read integers, also in the notation of floats, such as 1e6."""
    if info.type is not int:
        return None
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar="INT",
        instance_from_str=lambda words: _to_integer(words[0]),
        is_instance=lambda value: isinstance(value, int) and not isinstance(value, bool),
        str_from_instance=lambda value: [str(value)],
    )


def _to_integer(word: str) -> int:
    if re.fullmatch(r"\d+(\.\d*)?[eE]\+?\d{1,2}", word) and float(word).is_integer():
        return int(float(word))
    return int(word)


def parse_options(
    command: type[Command], prog: str, arguments: Sequence[str], **options: Any
) -> Command:
    """Make a command, a dataclass, from its options; ``options`` are those of `tyro.cli`."""
    given: set[str] = set()
    for word in arguments:
        name = word.partition("=")[0].replace("_", "-")
        if name in given:
            raise UserError(f"{name} is given twice; give it once, a list as {name} FIRST SECOND.")
        if re.match(r"--[a-z]", name):
            given.add(name)
    # Alternatives such as tasks are options, not commands: the default says which one is meant.
    options |= {"registry": REGISTRY, "config": (tyro.conf.AvoidSubcommands,)}
    if not any(word in HELP for word in arguments):
        return tyro.cli(command, prog=prog, args=arguments, **options)
    print(_rewrap(_printed(lambda: tyro.cli(command, prog=prog, args=["--help"], **options))))
    sys.exit(0)


def _printed(show: Callable[[], Any]) -> str:
    """Return what a function prints before it ends the program, in a single column."""
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = str(min(get_terminal_size().columns, WIDEST))
    try:
        with redirect_stdout(TextIOWrapper(BytesIO(), "utf-8")) as text, suppress(SystemExit):
            show()
    finally:
        os.environ.pop("COLUMNS") if before is None else os.environ.update(COLUMNS=before)
    text.seek(0)
    return text.read()


def _rewrap(text: str) -> str:
    """Wrap the texts in the boxes of a help text again, without the line breaks of the source."""
    lines: list[str] = []
    start, words, width = "", "", 0  # before the current text, the text, and its line's width
    for line in [*text.splitlines(), ""]:
        # An option or argument and its text, one of them, or a further line of the text.
        found = re.match(r"│ (-\S+(?: \S+)*|\S+(?=  )|)( *)([^-─\s].*?)? *│$", line)
        if found and found[3] and not found[1] and words and len(found[2]) == len(start):
            words += f" {found[3]}"
            continue
        if words:
            words = words.replace("``", "").replace(" (default: )", "")
            pieces = wrap(words, width - 4 - len(start), break_on_hyphens=False)
            heads = [start, *[" " * len(start)] * len(pieces)]
            lines += [f"│ {a + b:<{width - 3}}│" for a, b in zip(heads, pieces, strict=False)]
        start, words = (found[1] + found[2], found[3] or "") if found else ("", "")
        width = len(line)
        if not words:
            lines.append(line)
    return "\n".join(lines).strip()


def parse_command(command: Any, prog: str, about: str, arguments: Sequence[str]) -> Any:
    """Make a command from the words after its name ``prog``; ``about`` is the help of a group.

    ``command`` is a dataclass whose fields are the options, a class with a method ``parse``, a
    function of the words, or a group of these by name.
    """
    if isinstance(command, type):
        return getattr(command, "parse", partial(parse_options, command))(prog, arguments)
    if not isinstance(command, Mapping):
        return command(arguments)
    name, *rest = arguments or HELP
    if name in HELP:
        docs = {name: each.__doc__ or "" for name, each in command.items()}
        print(group_help(prog, about, {name: text.split("\n")[0] for name, text in docs.items()}))
        sys.exit(0)
    if name not in command:
        raise unknown_name(f"{prog.split()[-1]} command", name, command)
    return parse_command(command[name], f"{prog} {name}", "", rest)


def group_help(prog: str, about: str, commands: Mapping[str, str]) -> str:
    """Return the help text of a group of commands with their summaries."""
    width = max(map(len, commands))
    lines = [f"  {name:<{width}}  {summary}" for name, summary in commands.items()]
    start = f"usage: {prog} COMMAND [ARGUMENTS]\n\n{about}\n\ncommands:"
    return "\n".join([start, *lines, f"\n`{prog} COMMAND --help` shows a command's arguments."])


def answer_help(
    show: Callable[[], Any], prog: str, words: Sequence[str], first: str, about: str = ""
) -> list[str]:
    """Print the options ``first`` of a full help text, or the group after `--help`, and exit.

    Without `--help` return the words, with `--help-all` as the `--help` of the full text. ``show``
    prints the full text; ``first`` is a pattern of the names of options.
    """
    if not any(word in HELP for word in words):
        return ["--help" if word == "--help-all" else word for word in words]
    groups: dict[str, list[str]] = {}
    lines: list[str] = []  # of the box of positional arguments, which comes first
    for line in _printed(show).splitlines():
        if found := re.match(r"╭─ ([\w.-]+ )?options ─", line):
            groups[(found[1] or "").strip()] = lines = []
        elif line.startswith("│ "):
            lines.append(line.strip("│").rstrip())
    at = next(i for i, word in enumerate(words) if word in HELP)
    group = "".join(word for word in words[at + 1 : at + 2] if not word.startswith("-"))
    if group and group not in groups:
        raise unknown_name("group of options", group, filter(None, groups))
    print(f"usage: {prog} [OPTIONS]\n{about}")
    entries = [
        (name, entry)
        for name, lines in groups.items()
        for entry in re.split(r"\n(?= -)", "\n".join(lines))
        if entry.startswith(" --")
    ]
    for name, entry in entries:
        if f"{name}.".startswith(f"{group}.") if group else re.match(f" --({first})[ ,]", entry):
            head, *body = entry.splitlines()
            print(head, indent(fill(" ".join(map(str.strip, body)), 72), " " * 6), sep="\n")
    print(f"\n`{prog} --help-all` shows all {len(entries)} options, `--help GROUP` a group:")
    print("\n".join(f"  {name}" for name in groups if name))
    sys.exit(0)


def take_experiment(arguments: Sequence[str], usage: str) -> tuple[str, list[str]]:
    """Return the name of an experiment, which comes first, and the other words.

    Without a name the usage is printed and the process ends.
    """
    name, *rest = arguments or HELP
    if name in HELP:
        print(usage)
        sys.exit(0)
    if name.startswith("-"):
        problem = f"The first argument must be the name of an experiment, got {name}"
        raise UserError(f"{problem}; `knowarm list` explains their names.")
    return name, rest


def take_option(arguments: Sequence[str], flag: str, example: str) -> tuple[list[str], str | None]:
    """Take an option such as `--source analogy` out of arguments; return the others and its value.

    Options of its fields (`--source.file`) are left in place.
    """
    rest, found = [], None
    words = iter(arguments)
    for word in words:
        option, equals, name = word.partition("=")
        if option != flag:
            rest.append(word)
            continue
        name = name if equals else next(words, "--")
        if name.startswith("--"):
            raise UserError(f"{flag} needs a name, e.g. {flag} {example}.")
        if found is not None:
            raise UserError(f"{flag} is given twice; give it once.")
        found = name
    return rest, found


def take_source(arguments: Sequence[str], flag: str) -> tuple[list[str], "VectorSource | None"]:
    """Take the short name of a source of vectors out of arguments, as `take_option` does."""
    from knowarm.knowledge.vectors import source_named

    rest, name = take_option(arguments, flag, "wordnet-gloss-50")
    return rest, None if name is None else source_named(name)
