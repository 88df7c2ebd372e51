"""Where compiled libraries are kept: a folder that nobody else can write, with files whose names hold their hashes.

It does not grow without end: of more than 256 MB, some thousand libraries, those that were used longest ago go.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import logging
import os
import shutil
import stat
import tempfile
import time
from functools import cache
from pathlib import Path

import platformdirs

__all__ = ["digest_of", "is_whole", "own_folder", "remove_oldest", "used_now"]

LARGEST_FOLDER = 256_000_000  # bytes of all libraries; after a removal, half of it is left
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


def used_now(library: Path) -> None:
    """Note that a library was used, as far as that can be noted."""
    with contextlib.suppress(OSError):
        os.utime(library, ns=(time.time_ns(), os.lstat(library).st_mtime_ns))


def remove_oldest(folder: Path, largest: int = LARGEST_FOLDER) -> None:
    """Remove libraries that were used longest ago, if all of them together have more than ``largest`` bytes.

    A process that has loaded one keeps it.
    """
    found = []
    for library in folder.glob("*.so"):
        with contextlib.suppress(OSError):  # another process has removed it
            status = os.lstat(library)
            found.append((status.st_atime_ns, status.st_size, library))
    total = sum(size for _, size, _ in found)
    if total <= largest:
        return
    for _, size, library in sorted(found):
        if total <= largest // 2:
            return
        with contextlib.suppress(OSError):
            library.unlink()
        total -= size


def _is_mine(found: os.stat_result) -> bool:
    return not hasattr(os, "geteuid") or found.st_uid == os.geteuid()


@cache
def _private() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="clampid-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
