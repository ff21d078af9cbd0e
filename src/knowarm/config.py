"""Conversion between config dataclasses and JSON values, with strict checks when reading."""

import dataclasses
import re
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from functools import cache, partial
from typing import Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin

from knowarm.errors import UserError, unknown_name
from knowarm.ranges import check_number

T = TypeVar("T")
_READER = "knowarm.config.reader"


def registered(
    config_types: Callable[[], Iterable[type]], own: str = ""
) -> dict[str, Any]:
    """Return the metadata of a dataclass field that holds registered configs: one, or a tuple.

    The types are looked up whenever a config is read. As in a union, a literal field ``kind`` or
    ``name`` tells them apart in JSON. ``own`` names what other packages can register.
    """
    return {_READER: partial(_registered, config_types, own)}


TAGS = ("kind", "name")
"""Literal fields that tell configs apart, in the order of preference."""

_FILE_NAME = re.compile(r"\w[\w.+-]*", re.ASCII)
_hints: Callable[[Any], dict[str, Any]] = cache(typing.get_type_hints)
Fields = Mapping[str, Any]
"""Values of a config's fields, by name."""
_Reader = Callable[[Any, str], Any]
"""Converts a JSON value, and names it by its dotted path in errors."""


def check_values(config: Any, *, where: str = "", name: str = "") -> None:
    """Check types, choices and numbers, see `check_number`, of a (nested) config.

    ``name`` is that of the field whose value it is.
    """
    if isinstance(config, int | float):  # as most values are
        if not isinstance(config, bool):
            check_number(config, name, where)
    elif dataclasses.is_dataclass(config):
        prefix = where or type(config).__name__
        for name, field in _fields(typing.cast(Any, type(config))).items():
            value = getattr(config, name)
            path = f"{prefix}.{name}"
            if field.is_plain:
                field.read(value, path)
            check_values(value, where=path, name=name)
    elif isinstance(config, tuple | list):
        for i, value in enumerate(config):
            check_values(value, where=f"{where}[{i}]", name=name)
    elif isinstance(config, Mapping):
        for key, value in config.items():
            check_values(value, where=f"{where}.{key}")


class _Field(NamedTuple):
    """How a field of a config is read."""

    is_required: bool
    is_plain: bool  # Whether its values hold no configs
    read: _Reader


@cache
def _fields(cls: Any) -> dict[str, _Field]:
    """Return the fields of a config by name."""
    hints = _hints(cls)
    fields = {}
    for field in dataclasses.fields(cls):
        if field.init:
            hint = hints[field.name]
            is_required = field.default is field.default_factory is dataclasses.MISSING
            read = field.metadata.get(_READER)
            if read is None:
                read = _reader(hint)
            elif get_origin(hint) is tuple:
                read = partial(_tuple, [read], True)
            fields[field.name] = _Field(is_required, _is_plain(hint), read)
    return fields


@cache
def _is_plain(hint: Any) -> bool:
    """Return whether values of a type hold no configs."""
    if get_origin(hint) in (Union, types.UnionType, tuple):
        return all(map(_is_plain, get_args(hint)))
    if get_origin(hint) is Literal:
        return True
    return hint in (bool, int, float, str, type(None), Ellipsis)


def file_name(config: Any, name: str) -> None:
    """Check that a field of a config, where it is not None, names a file and no path."""
    value = getattr(config, name)
    is_name = isinstance(value, str) and _FILE_NAME.fullmatch(value)
    if value is not None and not is_name:
        raise UserError(
            f"{name} must be a name of letters, digits, '-', '_', '+' and '.', got {value!r}."
        )


def to_dict(config: Any) -> dict[str, Any]:
    """Convert a (nested) config dataclass to JSON values; tuples become lists."""
    names = [field.name for field in dataclasses.fields(config)]
    return {name: _plain(getattr(config, name)) for name in names}


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return to_dict(value)
    if isinstance(value, tuple | list):
        return list(map(_plain, value))
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    return value


def flatten(values: Fields, prefix: str = "") -> dict[str, Any]:
    """Return nested mappings as one mapping of dotted names."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = value
    return flat


def differences(first: Fields, second: Fields) -> dict[str, tuple[Any, Any]]:
    """Return both values of each field in which nested mappings differ, by dotted name."""
    one = flatten(first)
    other = flatten(second)
    different = {}
    for name in one | other:
        before = one.get(name)
        after = other.get(name)
        if before != after:
            different[name] = (before, after)
    return different


def override(config: T, overrides: Fields, *, where: str = "") -> T:
    """Copy a config with some fields changed and all types checked.

    Args:
        config: the dataclass instance to copy.
        overrides: new values by field name. A nested config takes a config, or a mapping of those
            of its fields that change: ``{"algorithm": {"num_envs": 64}}``.
        where: dotted path of ``config`` in the whole config, for error messages.
    """
    values = to_dict(config)
    rederived = getattr(config, "rederived", None)
    for name in rederived(overrides) if rederived else []:
        del values[name]
    for name, new in overrides.items():
        current = getattr(config, name, None)
        if isinstance(new, Mapping) and dataclasses.is_dataclass(current):
            tags = dict(_tags(typing.cast(Any, type(current))))
            if all(new.get(tag) in (None, getattr(current, tag)) for tag in tags):
                new = override(current, new, where=_path(where, name))
        values[name] = _plain(new)
    return from_dict(type(config), values, where=where)


def from_dict(cls: type[T], values: Fields, *, where: str = "") -> T:
    """Build a config dataclass from JSON values and check the type of every field.

    Args:
        cls: the dataclass to build.
        values: one value per field; fields with a default may be missing.
        where: dotted path of ``values`` in the whole config, for error messages.
    """
    kind = cls.__name__
    if not isinstance(values, Mapping):
        raise UserError(f"{where or kind} must hold fields of {kind}, got {values!r}.")
    fields = _fields(typing.cast(Any, cls))
    for name in values:
        if name not in fields:
            raise unknown_name(f"field of {where or kind}", name, fields)
    arguments = {}
    for name, field in fields.items():
        path = _path(where, name)
        if name in values:
            arguments[name] = field.read(values[name], path)
        elif field.is_required:
            raise UserError(f"Field {path!r} is missing; {kind} requires it.")
    return cls(**arguments)


def _path(where: str, name: str) -> str:
    """Return the dotted path of a field."""
    return f"{where}.{name}" if where else name


@cache
def _reader(hint: Any) -> _Reader:
    """Return what converts a JSON value to an annotated type."""
    origin = get_origin(hint)
    args = get_args(hint)
    if origin in (Union, types.UnionType):
        return partial(_union, args)
    if origin is Literal:
        return partial(_choice, args)
    if dataclasses.is_dataclass(hint):
        return lambda value, path: from_dict(typing.cast(Any, hint), value, where=path)
    if origin is tuple:
        items = [_reader(kind) for kind in args if kind is not Ellipsis]
        return partial(_tuple, items, Ellipsis in args)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return partial(_mapping, _reader(args[1]))
    if hint is float:
        return _float
    if isinstance(hint, type) and hint is not Any:
        return partial(_instance, hint)
    return lambda value, path: value


def _choice(allowed: tuple[Any, ...], value: Any, path: str) -> Any:
    if value not in allowed:
        raise unknown_name(f"value of {path}", str(value), map(str, allowed))
    return value


def _tuple(
    items: list[_Reader], repeats: bool, value: Any, path: str
) -> tuple[Any, ...]:
    """Convert a list to a tuple of some items, or of any number of one that repeats."""
    if not isinstance(value, list | tuple):
        raise UserError(f"{path} must be a list, got {value!r}.")
    if repeats:
        items = items * len(value)
    if len(items) != len(value):
        raise UserError(
            f"{path} must hold {len(items)} values, got {len(value)}: {value!r}."
        )
    return tuple(read(value[i], f"{path}[{i}]") for i, read in enumerate(items))


def _mapping(read: _Reader, value: Any, path: str) -> dict[Any, Any]:
    if not isinstance(value, Mapping):
        raise UserError(f"{path} must map names to values, got {value!r}.")
    return {key: read(item, f"{path}.{key}") for key, item in value.items()}


def _float(value: Any, path: str) -> float:
    if isinstance(value, int) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            bits = value.bit_length()
            raise UserError(f"{path} must be below 1.8e308, got {bits} bits.") from None
    return _instance(float, value, path)


def _instance(kind: type[T], value: Any, path: str) -> T:
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        raise UserError(f"{path} must be of type {kind.__name__}, got {value!r}.")
    return value


def _registered(
    config_types: Callable[[], Iterable[type]], own: str, value: Any, path: str
) -> Any:
    """Convert a value to the registered config that its tag names."""
    remedy = ""
    if own:
        remedy = f" Read one of your own with `--{own}s package.module:Name`, or register_{own}."
    return _union(tuple(config_types()), value, path, remedy)


def _union(args: tuple[Any, ...], value: Any, path: str, remedy: str = "") -> Any:
    """Convert a value to the first alternative that fits, or to the config that its tag names.

    ``remedy`` ends the error for an unknown tag.
    """
    if value is None and type(None) in args:
        return None
    kinds, tagged, only_config = _alternatives(args)
    if isinstance(value, Mapping) and only_config is not None:
        return from_dict(only_config, value, where=path)
    if isinstance(value, Mapping) and tagged:
        for (field, tag), kind in tagged.items():
            if value.get(field) == tag:
                return from_dict(kind, value, where=path)
        field, _ = next(iter(tagged))
        tags = [tag for _, tag in tagged]
        unknown = unknown_name(f"{path}.{field}", str(value.get(field)), tags)
        raise UserError(f"{unknown}{remedy}")
    if tagged and all(map(_tags, kinds)):
        names = ", ".join(kind.__name__ for kind in kinds)
        raise UserError(
            f"{path} must hold the fields of one of {names}, got {value!r}."
        )
    errors = []
    for kind in kinds:
        try:
            return _reader(kind)(value, path)
        except UserError as error:
            errors.append(str(error))
    if len(errors) == 1:
        raise UserError(errors[0])
    raise UserError(f"{path}: " + " Or: ".join(errors))


@cache
def _alternatives(
    args: tuple[Any, ...],
) -> tuple[list[Any], dict[tuple[str, str], Any], Any]:
    """Return a union's types, those with tags by tag, and the only config if none has tags.

    The fields of the only config tell it apart from numbers and texts.
    """
    kinds = [kind for kind in args if kind is not type(None)]
    tagged: dict[tuple[str, str], Any] = {}
    for kind in kinds:
        tagged |= dict.fromkeys(_tags(kind), kind)
    configs = [kind for kind in kinds if not _is_plain(kind)]
    if not tagged and len(configs) == 1 and dataclasses.is_dataclass(configs[0]):
        return kinds, tagged, configs[0]
    return kinds, tagged, None


@cache
def _tags(cls: Any) -> list[tuple[str, str]]:
    """Return the literal field that tells a config from others, see `TAGS`, with each value."""
    if dataclasses.is_dataclass(cls):
        hints = _hints(cls)
        for name in TAGS:
            if get_origin(hints.get(name)) is Literal:
                return [(name, tag) for tag in get_args(hints[name])]
    return []
