"""Effect files whose code may run: the user's own list, by the hash of each file.

An effect file is Python, and a model only names it. Opening a model therefore runs that file only if its hash stands in
the list (``clampid effect trust FILE``), or if the caller names the file (``--effects-from``). A file that is changed
has another hash and has to be trusted again.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
from pathlib import Path
from typing import Any

import platformdirs

from clampid.effect import EffectError
from experiments.outputs import write_text

__all__ = ["distrust", "hash_of", "is_trusted", "list_of_trusted", "trust", "trust_file"]

FORMAT = "clampid-trusted-effects/1"
MAX_BYTES = 1_000_000  # of an effect file, which is text that somebody has read


def trust_file() -> Path:
    """Where the list is: in the user's configuration folder (``$XDG_CONFIG_HOME/clampid`` on Linux)."""
    try:
        return Path(platformdirs.user_config_dir("clampid", appauthor=False)) / "trusted_effects.json"
    except RuntimeError as error:  # neither HOME nor an entry in the list of users
        raise EffectError(f"the list of trusted effects has no place: {error}") from error


def source_of(path: str | Path) -> bytes:
    """What an effect file holds; read once, so that what was judged is what runs.

    Raises
    ------
    EffectError
        There is no such regular file, or it is too long to be one.
    """
    try:
        if not Path(path).is_file():
            raise EffectError(
                f"{path}: expected a Python file that defines EFFECT, found no such file (it can be given as "
                "--effects-from FILE.py)"
            )
        with open(path, "rb") as file:
            source = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        if isinstance(error, EffectError):
            raise
        raise EffectError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if len(source) > MAX_BYTES:
        raise EffectError(f"{path}: expected a Python file of at most {MAX_BYTES} bytes, found a longer one")
    return source


def hash_of(source: bytes) -> str:
    """SHA-256 of what a file holds, hexadecimal."""
    return hashlib.sha256(source).hexdigest()


def is_trusted(source: bytes) -> bool:
    """Whether the hash of a source stands in the list."""
    return hash_of(source) in list_of_trusted()


def list_of_trusted() -> dict[str, str]:
    """Hash → the file as it was named when it was trusted.

    Raises
    ------
    EffectError
        The list is of another user, others may write it, or it is none.
    """
    path = trust_file()
    try:
        _check_owner(path.parent)
        _check_owner(Path(os.path.realpath(path)).parent)  # where it is a link
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise EffectError(f"{path}: the list of trusted effects cannot be read: {error.strerror}") from error
    found = os.fstat(handle)
    if not stat.S_ISREG(found.st_mode):
        os.close(handle)
        raise EffectError(f"{path}: expected the list of trusted effects, found no regular file")
    with open(handle, "rb") as file:
        _check_owner(path, found)
        raw = file.read(10 * MAX_BYTES)
    try:
        data: Any = json.loads(raw)
        if data["format"] != FORMAT:
            raise ValueError(f"format {data['format']!r}")
        return {str(entry["sha256"]): str(entry["file"]) for entry in data["trusted"]}
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise EffectError(f"{path}: expected the list of trusted effects, found something else: {error}") from error


def trust(path: str | Path) -> str:
    """Put what a file holds now on the list; its hash.

    Raises
    ------
    EffectError
        There is no such file, or the list cannot be used; see :func:`list_of_trusted`.
    """
    mark = hash_of(source_of(path))
    _save({**list_of_trusted(), mark: str(Path(path).absolute())})
    return mark


def distrust(path: str | Path) -> int:
    """Take a file off the list, whatever it holds now; how many entries are gone.

    Raises
    ------
    EffectError
        The list cannot be used; see :func:`list_of_trusted`.
    """
    known, file = list_of_trusted(), str(Path(path).absolute())
    mark = hash_of(source_of(path)) if Path(path).is_file() else None
    kept = {h: name for h, name in known.items() if name != file and h != mark}
    if len(kept) != len(known):
        _save(kept)
    return len(known) - len(kept)


def _save(known: dict[str, str]) -> None:
    path = trust_file()
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    except OSError as error:
        raise EffectError(f"{path}: the list of trusted effects cannot be written: {error.strerror}") from error
    _check_owner(path.parent)
    entries = [{"sha256": mark, "file": file} for mark, file in known.items()]
    write_text(path, json.dumps({"format": FORMAT, "trusted": entries}, indent=1) + "\n")


def _check_owner(path: Path, found: os.stat_result | None = None) -> None:
    """Refuse what somebody else owns or may write: who writes the list runs code."""
    if not hasattr(os, "geteuid"):  # Windows: the user's profile is the user's by its access list
        return
    found = os.stat(path) if found is None else found
    if found.st_uid not in (os.geteuid(), 0):
        raise EffectError(f"{path}: expected it to belong to you, found it of user {found.st_uid}")
    if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise EffectError(
            f"{path}: expected it to be writable by you alone, found mode {stat.S_IMODE(found.st_mode):o}"
        )
