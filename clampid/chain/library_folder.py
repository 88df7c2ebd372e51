"""Where compiled libraries are kept: a folder that nobody else can write, with files whose names hold their hashes."""

from __future__ import annotations

import atexit
import hashlib
import logging
import os
import shutil
import stat
import tempfile
from functools import cache
from pathlib import Path

import platformdirs

__all__ = ["digest_of", "is_whole", "own_folder"]

OTHERS = stat.S_IWGRP | stat.S_IWOTH

_log = logging.getLogger(__name__)


def own_folder() -> Path:
    """The folder in the user's cache; one of this process's own where that belongs to somebody else.

    Raises
    ------
    OSError
        It cannot be made.
    """
    try:
        top = Path(platformdirs.user_cache_dir("clampid", appauthor=False))
        folder = top / "compiled"
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    except (OSError, RuntimeError) as error:  # a home that cannot be written, or none at all
        _log.warning("what is compiled is not kept: %s", error)
        return _private()
    for part in (top, folder):
        found = os.lstat(part)
        if not stat.S_ISDIR(found.st_mode) or not _is_mine(found):
            _log.warning("%s belongs to somebody else: what is compiled is not kept", part)
            return _private()
        if found.st_mode & OTHERS:  # made under a umask that lets a group write
            os.chmod(part, stat.S_IMODE(found.st_mode) & ~OTHERS)
    return folder


def is_whole(library: Path) -> bool:
    """Whether a library is the user's own, nobody else can have changed it, and it is what its name says."""
    try:
        found = os.lstat(library)
        if not stat.S_ISREG(found.st_mode) or not _is_mine(found) or found.st_mode & OTHERS:
            return False
        return library.name.split(".")[-2] == digest_of(library)
    except (OSError, IndexError):
        return False


def digest_of(file: Path) -> str:
    """Half of the SHA-256 of a file, hexadecimal."""
    with open(file, "rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()[:32]


def _is_mine(found: os.stat_result) -> bool:
    return not hasattr(os, "geteuid") or found.st_uid == os.geteuid()


@cache
def _private() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="clampid-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
