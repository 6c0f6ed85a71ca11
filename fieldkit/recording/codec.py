"""Messages to JSON and back, exactly: `decode(type(x), encode(x)) == x` for every message that goes to disk.

A float64 survives because Python writes the shortest decimal that reads back as the same number. JSON has
no word for nan and the infinities, so they are the strings "nan", "inf" and "-inf"; the sign and payload of a
nan are not kept. A field whose value and default are both None is left out. Fields that this version does
not know are ignored, missing ones take their default: what an older schema 1 wrote can be read.
"""

import json
import math
import types
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cache
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

Message = TypeVar("Message")
#: Arrays with a fixed number of columns: an empty one would otherwise lose its shape.
COLUMNS = {"position_m": 2, "cov_m2": 2}
_NON_FINITE = ("nan", "inf", "-inf")


@dataclass(frozen=True, slots=True)
class _Shape:
    """What the codec needs to know about one message class."""

    names: tuple[str, ...]
    optional: tuple[str, ...]
    floats: tuple[str, ...]
    converters: tuple[tuple[str, Callable[[Any], Any]], ...]


def encode(message: Any, **extra: Any) -> bytes:
    """The message as compact JSON; `extra` keys go in front of its fields."""
    shape = _shape(type(message))
    values = {**extra, **{name: getattr(message, name) for name in shape.names}}
    for name in shape.optional:
        if values[name] is None:
            del values[name]
    return encode_value(values)


def encode_value(value: Any) -> bytes:
    """Plain values, arrays and messages as compact JSON, non-finite numbers as strings."""
    try:
        text = json.dumps(value, separators=(",", ":"), allow_nan=False, default=_plain)
    except ValueError:
        text = json.dumps(_spell(value), separators=(",", ":"), allow_nan=False)
    return text.encode("ascii")


def decode(kind: type[Message], data: bytes | dict[str, Any]) -> Message:
    """The message in `data`. Raises `KeyError`, `TypeError` or `ValueError` where it holds no such one."""
    values = json.loads(data) if isinstance(data, bytes) else data
    shape = _shape(kind)
    for name in shape.floats:
        if type(values.get(name)) is str:
            values[name] = _float(values[name])
    for name, convert in shape.converters:
        if name in values:
            values[name] = convert(values[name])
    return kind(**{name: values[name] for name in shape.names if name in values})


def _study(kind: Any) -> _Shape:
    hints = get_type_hints(kind)
    names = tuple(f.name for f in fields(kind))
    converters = []
    for name in names:
        convert = _converter(hints[name], name)
        if convert is not None and convert is not _float:
            converters.append((name, convert))
    return _Shape(
        names=names,
        optional=tuple(f.name for f in fields(kind) if f.default is None and f.default is not MISSING),
        floats=tuple(name for name in names if _converter(hints[name], name) is _float),
        converters=tuple(converters),
    )


_shape: Callable[[Any], _Shape] = cache(_study)


def array_scalar(hint: Any) -> type[np.generic] | None:
    """The scalar type of an `NDArray[...]` hint; None for any other hint.

    `NDArray` is a plain generic alias in some versions of numpy and a `type` alias (PEP 695) in others.
    """
    origin, args = get_origin(hint), get_args(hint)
    if origin is np.ndarray:
        return cast(type[np.generic], get_args(args[1])[0])
    if getattr(origin, "__name__", "") == "NDArray":
        return cast(type[np.generic], args[0])
    return None


def _converter(hint: Any, name: str) -> Callable[[Any], Any] | None:
    """How a JSON value becomes what the field holds; None where JSON's own type is it."""
    origin, args = get_origin(hint), get_args(hint)
    if hint is float:
        return _float
    if is_dataclass(hint):
        return lambda value: decode(hint, value)  # type: ignore[arg-type]
    if (scalar := array_scalar(hint)) is not None:
        columns = COLUMNS.get(name)
        return lambda value: _array(value, scalar, columns)
    if origin in (Union, types.UnionType):
        return next(filter(None, (_converter(arg, name) for arg in args)), None)
    if origin is tuple:
        inner = _converter(args[0], name)
        return lambda value: tuple(value if inner is None else map(inner, value))
    if origin is dict:
        inner = _converter(args[1], name)
        return None if inner is None else lambda value: {key: inner(item) for key, item in value.items()}
    return None


def _float(value: Any) -> Any:
    """A number as it is; one of the three words as the number it stands for."""
    if type(value) is not str:
        return value
    if value not in _NON_FINITE:
        raise ValueError(f"expected a number, 'nan', 'inf' or '-inf', got {value!r}")
    return float(value)


def _array(value: Any, dtype: Any, columns: int | None) -> np.ndarray:
    array = np.array(value, dtype=dtype)
    return array if columns is None else array.reshape(-1, columns)


def _plain(value: Any) -> Any:
    """What JSON does not know, as what it knows."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if is_dataclass(value):
        return {f.name: getattr(value, f.name) for f in fields(value)}
    raise TypeError(f"cannot record a {type(value).__name__}: {value!r}")


def _spell(value: Any) -> Any:
    """The value with every non-finite number spelled out."""
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else repr(float(value))
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, dict):
        return {key: _spell(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_spell(item) for item in value]
    return _spell(_plain(value))
