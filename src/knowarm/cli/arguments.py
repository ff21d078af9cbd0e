"""Parsing and help of the options of commands."""

import re
import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import MISSING, field, fields, is_dataclass, make_dataclass
from difflib import get_close_matches
from functools import partial
from itertools import dropwhile
from pathlib import Path
from textwrap import fill
from types import UnionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

import tyro
import tyro._errors as parse_errors  # what it could not read, before it draws that
from docstring_parser import parse_from_object
from tyro.conf import (
    AvoidSubcommands,
    DisallowNone,
    FlagCreatePairsOff,
    OmitArgPrefixes,
    Suppress,
    arg,
)
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
)

from knowarm.config import TAGS
from knowarm.errors import UserError, unknown_name
from knowarm.experiment import algorithms
from knowarm.reading import read_text
from knowarm.world import tasks

if TYPE_CHECKING:
    from knowarm.knowledge.vectors import VectorSource

Command = TypeVar("Command")
HELP = frozenset({"-h", "--help"})
OWN: dict[str, tuple[str, Callable[[str], Any]]] = {
    "--tasks": (tasks.VARIABLE, tasks.register_task),
    "--algorithms": (algorithms.VARIABLE, algorithms.register_algorithm),
}
"""Options of every command that import a part of your own: variable that does too, and how."""
REGISTRY = ConstructorRegistry()
"""Rules by which values of options are read, beside tyro's own."""
NO_TYPE = re.compile(
    r"no type matching (?:\{None\}\|)?(.*) could be instantiated from \[(.*)\]"
)
"""Message of tyro on a value: type and value."""


@REGISTRY.primitive_rule
def _integer(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[int] | None:
    """Read integers, also in the notation of floats, such as 1e6."""
    if info.type is not int:
        return None
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar="INT",
        instance_from_str=lambda words: _to_integer(words[0]),
        is_instance=lambda value: (
            isinstance(value, int) and not isinstance(value, bool)
        ),
        str_from_instance=lambda value: [str(value)],
    )


def _to_integer(word: str) -> int:
    if re.fullmatch(r"\d+(\.\d*)?[eE]\+?\d{1,2}", word) and float(word).is_integer():
        return int(float(word))
    try:
        return int(word)
    except ValueError:
        raise ValueError(
            f"expected a whole number, such as 200000 or 2e5, got {word!r}"
        ) from None


def parse_options(
    command: type[Command],
    prog: str,
    arguments: Sequence[str],
    **options: Any,
) -> Command:
    """Make a command, a dataclass, from its options; ``options`` are those of `tyro.cli`."""
    for name, count in Counter(map(_option_of, arguments)).items():
        if count > 1 and re.match(r"--[a-z]", name):
            raise UserError(
                f"{name} is given twice; give it once, a list as {name} FIRST SECOND."
            )
    shape = options.get("default") or command
    if HELP.intersection(arguments):
        _print_help(shape, prog)
    with parse_errors.on_parse_error(partial(_refuse, shape)):
        # Alternatives such as tasks are options, not commands: the default says which is meant.
        return tyro.cli(
            command,
            prog=prog,
            args=arguments,
            registry=REGISTRY,
            config=(AvoidSubcommands,),
            **options,
        )


def _option_of(word: str) -> str:
    """Return the option that a word gives, with or without its value."""
    return word.partition("=")[0].replace("_", "-")


def _refuse(shape: Any, event: parse_errors.ParseErrorEvent) -> None:
    """Raise the error of words that tyro cannot read, in one line.

    ``shape`` is the command, a class or an object of it. Events that are not known here are drawn
    by tyro.
    """
    error: BaseException | None = sys.exception()
    while error is not None:
        if isinstance(error, UserError):
            raise error from None  # of a config that refuses its values
        error = error.__context__
    match event:
        case parse_errors.InvalidChoice():
            option = event.argument.display_name()
            allowed = [choice for choice in event.choices if choice != "None"]
            raise unknown_name(f"value of {option}", event.value, allowed)
        case parse_errors.UnrecognizedArgs():
            unknown = ", ".join(event.tokens)
            problem = f"Unrecognized options: {unknown}.{_near(shape, event.tokens)}"
        case parse_errors.MissingArgs():
            missing = ", ".join(_as_typed(part.arg) for part in event.missing_arguments)
            problem = f"Missing from {event.prog}: {missing}."
        case parse_errors.BadValue(reason="too_few_values"):
            problem = f"Missing value of {event.argument.display_name()}."
        case parse_errors.InstantiationFailure():
            option = "the arguments"
            if event.argument:
                option = event.argument.display_name()
            problem = f"Error parsing {option}: {_in_words(event.message)}."
        case _:
            return
    raise UserError(f"{problem} `{event.prog} --help` shows the arguments.") from None


def _as_typed(argument: Any) -> str:
    """Return an argument as a command line gives it, such as ``RUN`` or ``--to DIR``."""
    value = str(argument.lowered.metavar)
    if argument.is_positional():
        return value
    return f"{argument.display_name()} {value}"


def _in_words(message: str) -> str:
    """Return the first line of a message of tyro on a value as the other errors say it."""
    line = NO_TYPE.sub(r"expected \1, got \2", message.partition("\n")[0])
    line = line.replace("could not convert string to float:", "expected a number, got")
    return line.rstrip(".:")


def _near(shape: Any, words: Sequence[str]) -> str:
    """Return a question after the options that mistyped ones may stand for."""
    options = list(_option_names(shape))
    near: list[str] = []
    for word in words:
        if word.startswith("--"):
            name = _option_of(word)
            near += [option for option in options if option.endswith(f".{name[2:]}")]
            near += get_close_matches(name, options, n=3, cutoff=0.7)
    if not near:
        return ""
    return f" Did you mean {', '.join(dict.fromkeys(near))}?"


def _option_names(shape: Any, prefix: str = "--") -> Iterator[str]:
    """Yield the options of a command, a class or an object of it."""
    for field_name, kind, value in _fields(shape):
        name = prefix + field_name.replace("_", "-")
        extras = get_args(kind)
        if not is_dataclass(value):
            yield name
        elif OmitArgPrefixes in extras or arg(name="") in extras:
            yield from _option_names(value, prefix)
        else:
            yield from _option_names(value, f"{name}.")


def _fields(shape: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield name, type and value of the fields of a class, whose value is its default, or object.

    A required field has tyro's missing value.
    """
    cls = shape if isinstance(shape, type) else type(shape)
    types = get_type_hints(cls, include_extras=True)
    for option in fields(cls):
        name = option.name
        value: Any = tyro.MISSING
        if shape is not cls:
            value = getattr(shape, name)
        elif option.default_factory is not MISSING:
            value = option.default_factory()
        elif option.default is not MISSING:
            value = option.default
        yield name, types[name], value


def answer_help(
    default: Any,
    prog: str,
    words: Sequence[str],
    first: Collection[str],
    about: str = "",
) -> list[str]:
    """Print the help of the fields ``first`` of a command, or of the group after `--help`; exit.

    Without `--help` return the words, with `--help-all` as the `--help` of all options. ``default``
    is the command with its defaults.
    """
    if HELP.isdisjoint(words):
        return ["--help" if word == "--help-all" else word for word in words]
    groups = {path.removeprefix("config."): path for path in _groups(default)}
    groups.pop("config", None)
    after_help = dropwhile(lambda word: word not in HELP, words)
    next(after_help)
    group = next(after_help, "")
    if group.startswith("-"):
        group = ""
    if group and group not in groups:
        raise unknown_name("group of options", group, groups)

    def is_shown(path: str) -> bool:
        if not group:
            return path in first
        return path.startswith(f"{groups[group]}.")

    with suppress(SystemExit):
        _print_help(default, prog, is_shown, about)
    print(f"`{prog} --help-all` shows all options, `--help GROUP` a group:")
    print(fill(", ".join(groups), 100, initial_indent="  ", subsequent_indent="  "))
    sys.exit(0)


def _print_help(
    default: Any,
    prog: str,
    is_shown: Callable[[str], bool] = lambda path: True,
    about: str = "",
) -> None:
    """Print the help of a command, a class or an object of it with its defaults, and exit."""
    tyro.cli(
        _showing(default, is_shown),
        prog=prog,
        args=["--help"],
        registry=REGISTRY,
        config=(AvoidSubcommands, DisallowNone),
        description=about or None,
    )


def _hint(default: str) -> str:
    """Return what the help says of a default value; nothing of one that says nothing."""
    if default in ("", "None", "False"):
        return ""
    return f"(default: {default})"


def _groups(config: Any, prefix: str = "") -> Iterator[str]:
    """Yield the paths of the configs within a config."""
    for name, value in vars(config).items():
        if is_dataclass(value):
            yield prefix + name
            yield from _groups(value, f"{prefix}{name}.")


def _showing(
    config: Any,
    is_shown: Callable[[str], bool],
    prefix: str = "",
    *,
    is_one_of: bool = False,
) -> type:
    """Return a class like a config's, with its values as defaults, whose help shows some fields.

    Only true flags are shown with their opposite, and tags of alternatives not at all: literals of
    one value, and those of a config that ``is_one_of`` several.
    """
    cls = config if isinstance(config, type) else type(config)
    help_texts = {}
    for base in reversed(cls.__mro__[:-1]):
        for param in parse_from_object(base).params:
            help_texts[param.arg_name] = " ".join((param.description or "").split())
    options: list[tuple[str, Any, Any]] = []
    for name, kind, value in _fields(config):
        extras: list[Any] = []
        if get_origin(kind) is Annotated:
            kind, *extras = get_args(kind)
        default: Callable[[], Any] = partial(copy, value)
        if is_dataclass(value):
            is_union = get_origin(kind) is UnionType
            kind = _showing(value, is_shown, f"{prefix}{name}.", is_one_of=is_union)
            default = kind
        elif not is_shown(prefix + name) or _is_tag(name, kind, is_one_of):
            extras.append(Suppress)
        elif value is False:
            extras.append(FlagCreatePairsOff)
        about = arg(help=help_texts.get(name), help_behavior_hint=_hint)
        filled = field() if value is tyro.MISSING else field(default_factory=default)
        options.append((name, Annotated[kind, about, *extras], filled))
    return make_dataclass(
        cls.__name__,
        options,
        bases=(cls,),
        frozen=True,
        kw_only=True,
        namespace={"__doc__": cls.__doc__},
    )


def _is_tag(name: str, kind: Any, is_one_of: bool) -> bool:
    """Return whether a field only tells a config from others."""
    if get_origin(kind) is not Literal:
        return False
    return len(get_args(kind)) == 1 or (is_one_of and name in TAGS)


def take_option(
    arguments: Sequence[str],
    flag: str,
    example: str,
) -> tuple[list[str], str | None]:
    """Take an option such as `--source analogy` out of arguments; return the others and its value.

    Options of its fields (`--source.file`) are left in place.
    """
    others: list[str] = []
    value = None
    words = iter(arguments)
    for word in words:
        option, equals, name = word.partition("=")
        if option != flag:
            others.append(word)
            continue
        if not equals:
            name = next(words, "--")
        if name.startswith("--"):
            raise UserError(f"{flag} needs a name, e.g. {flag} {example}.")
        if value is not None:
            raise UserError(f"{flag} is given twice; give it once.")
        value = name
    return others, value


def take_source(
    arguments: Sequence[str], flag: str
) -> tuple[list[str], "VectorSource | None"]:
    """Take the short name of a source of vectors out of arguments, as `take_option` does."""
    from knowarm.knowledge.vectors import source_named

    others, name = take_option(arguments, flag, "wordnet-gloss-50")
    return others, None if name is None else source_named(name)


def read_names(words: Sequence[str]) -> dict[str, str]:
    """Return the graph's names by object, from words and files of lines such as mug=CoffeeMug."""
    names = {}
    for word in words:
        lines = [word]
        if "=" not in word:
            remedy = "Give mug=CoffeeMug, or a file of such lines."
            lines = read_text(Path(word), remedy=remedy).split("\n")
        for line in filter(None, map(str.strip, lines)):
            name, _, other = map(str.strip, line.partition("="))
            if not (name and other):
                raise UserError(
                    f"names: {line!r} must be an object and its name, such as mug=CoffeeMug."
                )
            names[name] = other
    return names
