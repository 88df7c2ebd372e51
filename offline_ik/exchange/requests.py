"""Requests of the line protocol: a word and ``key=value`` pairs, and the numbers in them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from clampid.wrong_call import CallError

__all__ = [
    "EVERY", "GREETED", "MOVES", "WORDS", "RequestError", "is_request", "is_stop", "number", "numbers", "parse",
    "switch",
]  # fmt: skip

Array = npt.NDArray[np.float64]

WORDS = {
    "hello": ("token", "name"),
    "where": ("gamma", "delta", "r", "roll", "near", "branch", "approach", "direction", "pyfai"),
    "path": ("gamma", "delta", "r", "roll", "from", "branch", "approach", "direction", "to"),
    "stream": ("gamma", "delta", "r", "roll", "direction", "dt"),
    "start": ("q",),
    "temperature": ("link", "motor", "running"),
    "at": ("q", "near"),
    "simulate": ("gamma", "delta", "r", "roll", "from", "branch", "approach", "direction", "picture"),
    "pixel": ("i", "j", "pixels", "gamma", "delta", "r", "roll", "q", "near", "poni", "wavelength"),
    "move": ("gamma", "delta", "r", "roll", "approach", "direction", "wait"),
    "moved": ("timeout", "number"),
    "robot": (),
    "hold": (),
    "release": (),
    "confirm": (),
    "sample": (
        "q", "gamma", "delta", "r", "roll", "dir", "x", "y", "two_theta", "spacing", "wavelength", "std", "std_xy",
        "near", "repeatability",
    ),
    "stop": (),
    "state": (),
    "help": (),
    "quit": (),
}  # fmt: skip
"""The requests and their keys; every one may have those of :data:`EVERY` too."""

GREETED = frozenset({"move", "hold", "confirm", "temperature", "start", "stream"})
"""Requests that change something or move: a connection says `hello` before. `stop` is always obeyed."""

MOVES = frozenset({"move", "hold", "confirm", "temperature"})
"""Requests that a server refuses which a network reaches and which has no token: it only answers."""

EVERY = ("id", "robot")
STOP = b"stop"


class RequestError(CallError):
    """A line that is no request; the message says what was expected."""


def is_stop(line: bytes) -> bool:
    """Whether the first word of a line is `stop`, in whatever case."""
    return line[: len(STOP) + 64].lower().split(None, 1)[:1] == [STOP]


def is_request(line: bytes) -> bool:
    """Whether a line begins with the word of a request, whatever follows it."""
    words = line.split(None, 1)
    return is_stop(line) or bool(words and words[0].decode("ascii", "replace") in WORDS)


def parse(line: bytes) -> tuple[str, dict[str, str]]:
    """A request's word and its pairs.

    Raises
    ------
    RequestError
        The line is no text, its word is not known, a pair is none, not known there, or comes twice.
    """
    if is_stop(line):  # whatever else stands there: somebody is in a hurry
        pairs = dict(part.split("=", 1) for part in line.decode("ascii", "replace").split()[1:] if "=" in part)
        return "stop", {"id": pairs["id"]} if "id" in pairs else {}
    try:
        parts = line.decode("ascii").split()
    except UnicodeDecodeError:
        raise RequestError("expected a line of ASCII text, found other bytes") from None
    if not parts:
        raise RequestError(f"expected a request, found an empty line; known: {', '.join(WORDS)}")
    word, given = parts[0], {}
    if word not in WORDS:
        raise RequestError(f"no request is called {word[:40]!r}; known: {', '.join(WORDS)}")
    for part in parts[1:]:
        key, equals, value = part.partition("=")
        if not equals or not value:
            raise RequestError(f"{word}: expected key=value, found {part[:40]!r}")
        if key not in EVERY and key not in WORDS[word]:
            raise RequestError(f"{word}: no key is called {key[:40]!r}; known: {', '.join((*WORDS[word], *EVERY))}")
        if key in given:
            raise RequestError(f"{word}: {key} is given twice")
        given[key] = value
    return word, given


def number(given: Mapping[str, str], key: str, default: float | None = None) -> float:
    """A number of a request.

    Raises
    ------
    RequestError
        It is none, or absent where there is no default.
    """
    if key not in given:
        if default is None:
            raise RequestError(f"expected {key}=NUMBER")
        return default
    try:
        return float(_plain(given[key]))
    except ValueError:
        raise RequestError(f"{key}: expected a number, found {given[key][:40]!r}") from None


def _plain(text: str) -> str:
    """The same; nothing, which is no number, for what Python alone takes for one: 0_8 as 8."""
    return "" if "_" in text else text


def numbers(given: Mapping[str, str], key: str) -> Array | None:
    """Numbers separated by commas ``(k,)``, or None where the key is absent.

    Raises
    ------
    RequestError
        One is no number.
    """
    if key not in given:
        return None
    try:
        return np.array([float(part) for part in _plain(given[key]).split(",")])
    except ValueError:
        raise RequestError(f"{key}: expected numbers separated by commas, found {given[key][:40]!r}") from None


def switch(given: Mapping[str, str], key: str) -> bool:
    """Whether a key says ``yes``; absent it is ``no``.

    Raises
    ------
    RequestError
        It says anything else.
    """
    value = given.get(key, "no")
    if value not in ("yes", "no"):
        raise RequestError(f"{key}: expected yes or no, found {value[:40]!r}")
    return value == "yes"
