"""Mutations of files: bytes, slices, numbers, tokens, lines, and values inside JSON."""

import json
import re

import numpy as np

TOKENS = [
    b"\0",
    b"\xff\xfe",
    b"\xc3",
    b"\xf0\x9f",
    b"\r",
    b"\n\n",
    b'"',
    b"'",
    b"\\",
    b"{",
    b"}",
    b"[",
    b"]",
    b"<",
    b">",
    b"&",
    b";",
    b",",
    b"=",
    b"#",
    b"%",
    b"@",
    b"null",
    b"true",
    b"NaN",
    b"inf",
    b"-inf",
    b"1e999",
    b"-1",
    b"0",
    b"9" * 30,
    b"\\uD800",
    b"\\u0000",
    "²٣".encode(),
    b"../" * 9,
    b"a" * 5000,
    b"(" * 500,
    b"[" * 500,
    b'{"a":' * 500,
    b"SERVICE",
    b"FROM NAMED <urn:x>",
    b"<!ENTITY a '&b;'>",
    b'"@context": "http://127.0.0.1:1/"',
    b"=HYPERLINK(1)",
    b"\x1b[31m",
]
"""Pieces that parsers treat specially."""

VALUES = [
    None,
    True,
    -1,
    0,
    2**31,
    2**63,
    2**70,
    -(2**70),
    0.5,
    1e308,
    float("nan"),
    float("inf"),
    "",
    "x",
    "a" * 5000,
    "\0",
    "\ud800",
    "../../..",
    [],
    [[]],
    [1, "a"],
    {},
    {"kind": "x"},
]
"""Values that replace others in JSON."""

NUMBERS = [
    b"-1",
    b"0",
    b"1e308",
    b"nan",
    b"inf",
    b"99999999999999999999",
    b"4294967296",
    b"",
    b"x",
]
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def mutate(data: bytes, random: np.random.Generator, *, is_json: bool = False) -> bytes:
    """Return a file with one to four random mutations."""
    for _ in range(int(random.integers(1, 5))):
        if is_json and random.random() < 0.5:
            data = mutate_json(data, random)
        else:
            data = MUTATIONS[int(random.integers(len(MUTATIONS)))](data, random)
    return data


def _place(data: bytes, random: np.random.Generator) -> int:
    return int(random.integers(len(data) + 1))


def _slice(data: bytes, random: np.random.Generator) -> tuple[int, int]:
    begin = _place(data, random)
    longest = 2 ** int(random.integers(1, 12))
    return begin, min(len(data), begin + int(random.integers(1, longest + 1)))


def _flip(data: bytes, random: np.random.Generator) -> bytes:
    changed = bytearray(data)
    for _ in range(int(random.integers(1, 4)) if data else 0):
        changed[int(random.integers(len(data)))] ^= 1 << int(random.integers(8))
    return bytes(changed)


def _delete(data: bytes, random: np.random.Generator) -> bytes:
    begin, end = _slice(data, random)
    return data[:begin] + data[end:]


def _repeat(data: bytes, random: np.random.Generator) -> bytes:
    begin, end = _slice(data, random)
    return data[:end] + data[begin:end] * int(random.integers(1, 4)) + data[end:]


def _truncate(data: bytes, random: np.random.Generator) -> bytes:
    return data[: _place(data, random)]


def _insert(data: bytes, random: np.random.Generator) -> bytes:
    place = _place(data, random)
    return data[:place] + TOKENS[int(random.integers(len(TOKENS)))] + data[place:]


def _number(data: bytes, random: np.random.Generator) -> bytes:
    found = list(_NUMBER.finditer(data[:200_000]))
    if not found:
        return data
    one = found[int(random.integers(len(found)))]
    number = NUMBERS[int(random.integers(len(NUMBERS)))]
    return data[: one.start()] + number + data[one.end() :]


def _swap_lines(data: bytes, random: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    a, b = random.integers(len(lines), size=2)
    lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


MUTATIONS = [_flip, _delete, _repeat, _truncate, _insert, _number, _swap_lines]


def mutate_json(data: bytes, random: np.random.Generator) -> bytes:
    """Replace or remove a value at a random place, or give it a wrong name."""
    try:
        whole = json.loads(data)
    except (ValueError, RecursionError):
        return data
    holder, keys = whole, _keys(whole)
    while keys:
        key = keys[int(random.integers(len(keys)))]
        if not _keys(holder[key]) or random.random() < 0.3:
            kind = random.random()
            if kind < 0.7:
                holder[key] = VALUES[int(random.integers(len(VALUES)))]
            elif kind < 0.9 or not isinstance(key, str):
                del holder[key]
            else:
                holder["x" + key] = holder.pop(key)
            break
        holder, keys = holder[key], _keys(holder[key])
    return json.dumps(whole).encode()


def _keys(value) -> list:
    if isinstance(value, dict):
        return list(value)
    return list(range(len(value))) if isinstance(value, list) else []
