"""Spoils files: bytes changed, cut and put in, tokens replaced by what breaks readers."""

from __future__ import annotations

import random
import re

__all__ = ["HOSTILE", "spoilt"]

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
    found = [m.span() for m in _TOKEN.finditer(data[:200_000])]
    if not found:
        return data + rng.choice(HOSTILE)
    start, end = rng.choice(found)
    return data[:start] + rng.choice(HOSTILE) + data[end:]


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
