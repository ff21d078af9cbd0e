"""Config dataclasses go in and plain JSON values come out, and the strict way back."""

import dataclasses
import types
import typing
from collections.abc import Iterable, Mapping
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

from knowarm.errors import UserError, unknown_name

T = TypeVar("T")


def to_dict(config: Any) -> dict[str, Any]:
    """Turn a (nested) config dataclass into JSON values; tuples become lists."""
    return {field.name: _plain(getattr(config, field.name)) for field in dataclasses.fields(config)}


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return to_dict(value)
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    return value


def from_dict(cls: type[T], values: Mapping[str, Any], *, where: str = "") -> T:
    """Build a config dataclass from JSON values, field by field, checking every type.

    Args:
        cls: the dataclass to build.
        values: one value a field; fields that have a default may be missing.
        where: dotted path of ``values`` in the whole config, for the error messages.

    Raises:
        UserError: an unknown field (with the nearest names), a missing one, or a value of
            another type than the field's.
    """
    if not isinstance(values, Mapping):
        raise UserError(
            f"{where or cls.__name__} must hold fields of {cls.__name__}, got {values!r}."
        )
    hints = typing.get_type_hints(cls)
    fields = {
        field.name: field for field in dataclasses.fields(typing.cast(Any, cls)) if field.init
    }
    for name in values:
        if name not in fields:
            raise unknown_name(f"field of {where or cls.__name__}", name, fields)
    arguments = {}
    for name, field in fields.items():
        path = f"{where}.{name}" if where else name
        if name in values:
            arguments[name] = _typed(hints[name], values[name], path)
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            raise UserError(f"Field {path!r} is missing; {cls.__name__} needs it.")
    return cls(**arguments)


def _typed(hint: Any, value: Any, path: str) -> Any:
    """Convert one JSON value to the annotated type, or say what the field takes."""
    origin, args = get_origin(hint), get_args(hint)
    if origin is typing.Annotated:
        return _typed(args[0], value, path)
    if origin in (Union, types.UnionType):
        return _union(args, value, path)
    if origin is Literal:
        if value not in args:
            raise unknown_name(f"value of {path}", str(value), map(str, args))
        return value
    if hasattr(hint, "variants"):  # a base class with a registry of its configs
        return _variant(hint.variants().values(), value, path)
    if dataclasses.is_dataclass(hint):
        return from_dict(typing.cast(Any, hint), value, where=path)
    if origin is tuple:
        if not isinstance(value, list | tuple):
            raise UserError(f"{path} must be a list, got {value!r}.")
        inner = [args[0]] * len(value) if args[-1] is Ellipsis else list(args)
        if len(inner) != len(value):
            raise UserError(f"{path} must hold {len(inner)} values, got {len(value)}: {value!r}.")
        return tuple(
            _typed(kind, item, f"{path}[{i}]")
            for i, (kind, item) in enumerate(zip(inner, value, strict=True))
        )
    if origin in (dict, Mapping) or (isinstance(origin, type) and issubclass(origin, Mapping)):
        if not isinstance(value, Mapping):
            raise UserError(f"{path} must map names to values, got {value!r}.")
        return {key: _typed(args[1], item, f"{path}.{key}") for key, item in value.items()}
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if isinstance(hint, type) and (
        not isinstance(value, hint) or (isinstance(value, bool) and hint is not bool)
    ):
        raise UserError(f"{path} must be of type {hint.__name__}, got {value!r}.")
    return value


def _union(args: tuple[Any, ...], value: Any, path: str) -> Any:
    if value is None and type(None) in args:
        return None
    kinds = [kind for kind in args if kind is not type(None)]
    configs = [kind for kind in kinds if dataclasses.is_dataclass(kind)]
    if configs and isinstance(value, Mapping) and len(configs) > 1:
        return _variant(configs, value, path)
    errors = []
    for kind in kinds:
        try:
            return _typed(kind, value, path)
        except UserError as error:
            errors.append(str(error))
    raise UserError(errors[0] if len(errors) == 1 else f"{path}: " + " Or: ".join(errors))


def _variant(configs: Iterable[Any], value: Any, path: str) -> Any:
    """Build the one of several configs whose literal field (`kind` or `name`) has the value's."""
    tags: dict[tuple[str, Any], Any] = {}
    for config in configs:
        hints = typing.get_type_hints(config)
        tag = next(name for name in ("kind", "name") if get_origin(hints.get(name)) is Literal)
        tags |= {(tag, kind): config for kind in get_args(hints[tag])}
    tag = next(iter(tags))[0]
    kinds = [kind for _, kind in tags]
    if not isinstance(value, Mapping):
        raise UserError(f"{path} must hold fields with {tag} one of {kinds}, got {value!r}.")
    if (tag, value.get(tag)) not in tags:
        raise unknown_name(f"{path}.{tag}", str(value.get(tag)), kinds)
    return from_dict(tags[tag, value[tag]], value, where=path)
