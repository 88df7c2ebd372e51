"""Spoils files: bytes changed, cut and put in, tokens replaced; or values, so that a parser takes what comes of it."""

from __future__ import annotations

import copy
import csv
import functools
import io
import json
import math
import pickle
import random
import re
import tomllib
from pathlib import Path
from typing import Any

__all__ = ["HOSTILE", "VALUES", "misstated", "spoilt"]

HOSTILE = [
    b"", b"0", b"-1", b"1", b"1e99999999", b"\"1e99999999\"", b"-1e30", b"1e-320", b"nan", b"inf", b"-inf", b"NaN",
    b"Infinity", b"true", b"null", b"1000000000", b"9007199254740993", b"18446744073709551616", b"9" * 5000, b"[", b"]",
    b"{", b"}", b"[" * 3000, b"{\"a\":" * 2000, b"\"\"", b"\"\\u0000\"", b"\"\\ud800\"", b"\"x\"",
    b"\"../../etc/passwd\"",
    b"\"/dev/zero\"", b"[1, 2]", b"[]", b"{}", b"\r", b"\n", b"\t", b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"\xc3", b",",
    b";", b"=", b"\"", b"'", b"a" * 200_000, b"1,2", b"link99", b"\x1b[2J", b"1979-05-27T07:32:00Z", b"0x10", b"1_000",
    b"-0.0", b"1.7976931348623157e308", b"5e-9", b"\xe2\x80\xae",
]  # fmt: skip
_TOKEN = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?|\"[^\"\n]{0,80}\"|[A-Za-z_]\w*|[\[\]{}=,:;<>/]")


def spoilt(good: bytes, seed: int) -> bytes:
    """A file that is a little, or very much, not what it was.

    Parameters
    ----------
    good
        What a reader takes.
    seed
        Of what is done to it.
    """
    rng, data = random.Random(seed), good
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        data = rng.choice((_token, _token, _token, _flip, _cut, _put, _repeat, _swap))(data, rng)
    return data


def _token(data: bytes, rng: random.Random) -> bytes:
    found = _tokens(data)
    if not found:
        return data + rng.choice(HOSTILE)
    start, end = rng.choice(found)
    return data[:start] + rng.choice(HOSTILE) + data[end:]


@functools.lru_cache(maxsize=2)
def _tokens(data: bytes) -> list[tuple[int, int]]:
    """Where the tokens of a file are; most files are spoilt from the same one."""
    return [m.span() for m in _TOKEN.finditer(data[:200_000])]


@functools.lru_cache(maxsize=2)
def _pickled(good: bytes, ending: str) -> bytes:
    """What a good file says; to take it out again costs a tenth of parsing it."""
    return pickle.dumps(tomllib.loads(good.decode()) if ending == ".toml" else json.loads(good))


@functools.lru_cache(maxsize=2)
def _rows(good: bytes) -> list[list[str]]:
    """The cells of a good table."""
    return list(csv.reader(io.StringIO(good.decode())))


def _flip(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 3, 30))):
        if changed:
            changed[rng.randrange(len(changed))] = rng.randrange(256)
    return bytes(changed)


def _cut(data: bytes, rng: random.Random) -> bytes:
    start = rng.randrange(len(data) + 1)
    return data[:start] + (b"" if rng.random() < 0.5 else data[start + rng.randrange(200) :])


def _put(data: bytes, rng: random.Random) -> bytes:
    start = rng.randrange(len(data) + 1)
    return data[:start] + rng.choice(HOSTILE) + data[start:]


def _repeat(data: bytes, rng: random.Random) -> bytes:
    lines = data.split(b"\n")
    k = rng.randrange(len(lines))
    return b"\n".join([*lines[: k + 1], *lines[k : k + 1] * rng.choice((1, 100)), *lines[k + 1 :]])


def _swap(data: bytes, rng: random.Random) -> bytes:
    lines = data.split(b"\n")
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


VALUES: list[Any] = [
    0, 1, -1, 2, 3, 7, 64, 0.0, -0.0, 1e-12, -1e-12, 0.5, 1.5, 100.0, 1e4, 1e9, -1e9, 1e30, 1e-30, 1e-320, 1e308,
    -1e308, 2**31, 2**53 + 1, 2**63, 10**30, True, False, math.nan, math.inf, -math.inf, "", "x", "1", "1/3", "flange",
    "joint1", "joint2", "link99", "T1", "T9", "poses", "none", "nan", "a" * 5000, "../../etc/passwd", "/dev/zero",
    "campaign.toml", "<script>alert(1)</script>", "'\"><svg onload=alert(1)>", "=1+1", "$(id)", "\u202e", "\x1b[2J",
    "\n", [], {}, [0.0], [0, 0, 0], [0.0, 0.0, 0.0], [1e9, 0.0, 0.0], [math.nan] * 3, [1.0] * 6, [[]], [[0.0]], [{}],
    {"a": 1}, ["T1", "T1"], ["T1", "T2"], [True, True, True], ["x"] * 3, [0.0] * 1000, None,
]  # fmt: skip


def misstated(good: bytes, seed: int, name: str) -> bytes:
    """A file of the same syntax that says something else: TOML, JSON, or a table by its name's ending.

    Parameters
    ----------
    good
        What a reader takes.
    seed
        Of what is done to it.
    name
        The file's name.
    """
    rng, ending = random.Random(seed), Path(name).suffix
    if ending == ".csv":
        rows = [list(row) for row in _rows(good)]
        for _ in range(rng.choice((1, 1, 1, 2, 5))):
            _misstate_cell(rows, rng)
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(rows)
        return text.getvalue().encode("utf-8", "replace")
    content = pickle.loads(_pickled(good, ending))
    for _ in range(rng.choice((1, 1, 1, 1, 2, 4))):
        _misstate(content, rng)
    text = (
        "".join(f"{_key(k)} = {_toml(v)}\n" for k, v in content.items()) if ending == ".toml" else json.dumps(content)
    )
    return text.encode("utf-8", "replace")


def _misstate_cell(rows: list[list[str]], rng: random.Random) -> None:
    row = rows[rng.choice((0, rng.randrange(len(rows)), rng.randrange(len(rows))))]
    what, k = rng.randrange(8), rng.randrange(max(1, len(row)))
    if what == 0 and len(rows) > 2:
        del rows[rng.randrange(1, len(rows))]
    elif what == 1:
        rows.append(list(row))
    elif what == 2:  # a whole column
        value = copy.deepcopy(rng.choice(VALUES))
        for one in rows[1:]:
            one[k : k + 1] = [str(value)]
    elif what == 3:
        for one in rows[1:]:
            with_number = one[k : k + 1]
            one[k : k + 1] = [f"{1e3 * float(v):.6g}" if re.fullmatch(r"-?[0-9.e-]+", v) else v for v in with_number]
    elif what == 4:
        del rows[rng.randrange(2, max(3, len(rows))) :]
    elif row:
        row[k] = str(copy.deepcopy(rng.choice(VALUES)))


def _misstate(content: Any, rng: random.Random) -> None:
    """Change one thing somewhere in it."""
    at = content
    while True:
        keys = list(at) if isinstance(at, dict) else list(range(len(at)))
        if not keys:
            if isinstance(at, dict):
                at["x"] = copy.deepcopy(rng.choice(VALUES))
            return
        key = rng.choice(keys)
        if not isinstance(at[key], dict | list) or rng.random() < 0.15:
            break
        at = at[key]
    what, other = rng.randrange(10), rng.choice(keys)
    if what == 0:
        del at[key]
    elif what == 1 and isinstance(at, dict):
        at[rng.choice(("x", f"{key}s", f"{key}_mm", key[:-1] or "y", "T9", "a" * 300, "<b>", "\n"))] = at.pop(key)
    elif what == 1 or (what == 2 and isinstance(at, list)):
        at.insert(0, copy.deepcopy(at[key]))
    elif what == 2:
        at[rng.choice(("x", f"{key}2", "poses", "joint1", "T9"))] = copy.deepcopy(at[key])
    elif what == 3:
        at[key], at[other] = at[other], at[key]
    elif what in (4, 5) and isinstance(at[key], int | float):
        at[key] = at[key] * rng.choice((0, -1, 1e3, 57.3, 1e-3, 1e12))
    else:
        at[key] = copy.deepcopy(rng.choice(VALUES))


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key)


def _toml(value: Any) -> str:
    """A value in one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(k)} = {_toml(v)}" for k, v in value.items() if v is not None) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(v) for v in value if v is not None) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
    return '""' if value is None else json.dumps(value)
