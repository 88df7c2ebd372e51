"""
Files that somebody else wrote, read with bounds: regular files or pipes of a bounded size, TOML and JSON of any depth.

A device such as ``/dev/zero`` never ends, a hundred thousand brackets end the interpreter's stack, and a number of
millions of digits takes minutes. Each is an ordinary error here, of the kinds that readers already report.
"""

import errno
import json
import os
import re
import stat
import tomllib
from fractions import Fraction
from pathlib import Path
from typing import Any

__all__ = ["MAX_BYTES", "fraction_of", "json_of", "read_bytes", "read_text", "toml_of"]

MAX_BYTES = 200_000_000  # of a file that is read whole
_FRACTION = re.compile(r"\s*[-+]?\d{1,18}(?:/\d{1,18}|(?:\.\d{0,18})?(?:[eE][-+]?\d{1,2})?)\s*", re.ASCII)


def read_bytes(path: str | Path, most: int = MAX_BYTES) -> bytes:
    """
    Read a file whole.

    Parameters
    ----------
    path
        A regular file, or a pipe.
    most
        Bytes at most.

    Returns
    -------
    bytes
        All of it.

    Raises
    ------
    OSError
        It cannot be read, is a device, or is longer.
    """
    try:
        kind = os.stat(path).st_mode
    except ValueError as error:  # a NUL in the name
        raise OSError(errno.EINVAL, str(error), str(path)) from None
    if stat.S_ISDIR(kind):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not (stat.S_ISREG(kind) or stat.S_ISFIFO(kind)):
        raise OSError(errno.EINVAL, "expected a regular file, found a device", str(path))
    with open(path, "rb") as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"expected at most {most} bytes", str(path))
    return data


def read_text(path: str | Path, most: int = MAX_BYTES) -> str:
    """Read a text file in UTF-8, with or without its mark; see `read_bytes`. Raises UnicodeDecodeError, too."""
    return read_bytes(path, most).decode("utf-8-sig")


def toml_of(text: str) -> dict[str, Any]:
    """Parse TOML; what is nested too deeply, or has numbers too long to read, is a TOMLDecodeError as well."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError:
        raise tomllib.TOMLDecodeError("nested too deeply") from None
    except ValueError as error:  # an integer of thousands of digits, a date that is none
        raise tomllib.TOMLDecodeError(str(error)) from None


def json_of(text: str) -> Any:
    """Parse JSON; nested too deeply, a key given twice and numbers that are not finite are JSONDecodeErrors as well."""
    try:
        return json.loads(text, parse_constant=_refused, object_pairs_hook=_once)
    except json.JSONDecodeError:
        raise
    except RecursionError:
        raise json.JSONDecodeError("nested too deeply", text[:80], 0) from None
    except ValueError as error:
        raise json.JSONDecodeError(str(error), text[:80], 0) from None


def fraction_of(value: object) -> float:
    """
    Read a number, or one as text: ``1/3``, ``-2.5``.

    Parameters
    ----------
    value
        A number or a text.

    Returns
    -------
    float
        The number.

    Raises
    ------
    ValueError
        It is none, or has an exponent that would take long to work out.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f"expected a number or a fraction as text, found {str(value)[:40]!r}")
    if isinstance(value, str):
        if not _FRACTION.fullmatch(value):
            raise ValueError(f"expected a number or a fraction as text, found {value[:40]!r}")
        try:
            return float(Fraction(value))
        except ZeroDivisionError:
            raise ValueError(f"expected a number or a fraction as text, found {value!r}") from None
    return float(value)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"the key {next(n for n in names if names.count(n) > 1)!r} comes twice")
    return found


def _refused(name: str) -> Any:
    raise ValueError(f"expected finite numbers, found {name}")
