"""Every file that the program writes goes through here: whole, on the disk, and never over something of another kind.

A regular file is written under a temporary name beside it, flushed to the disk, and renamed. Links are followed.
Devices, pipes and ``/dev/stdout`` are written to directly, because a rename would replace them.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import stat
import sys
import tempfile
import uuid
from collections.abc import Iterator
from pathlib import Path

__all__ = ["OutputError", "check_output", "flush_folder", "is_stdout", "new_file", "write_bytes", "write_text"]

DISK = (errno.ENOSPC, errno.EDQUOT, errno.EIO)
"""Errors of a disk and not of the call: they keep their own kind (exit code 1)."""
KINDS = {
    stat.S_IFBLK: "a block device",
    stat.S_IFSOCK: "a socket",
    stat.S_IFDIR: "a folder",
}


class OutputError(ValueError):
    """A file that cannot be written where it was asked for; the message names it."""


def is_stdout(path: str | Path) -> bool:
    """Whether a path is another name of this process's standard output."""
    return _descriptor(path) == 1


def check_output(path: str | Path) -> Path:
    """Check that a file can be written there, without writing it: to be called before long work.

    Parameters
    ----------
    path
        Where a file is to go. Folders that do not exist yet are made when it is written.

    Raises
    ------
    OutputError
        There is a folder, a block device or a socket, something above is no folder, or writing is not permitted.
    """
    if _descriptor(path) is not None:
        return Path(path)
    found = _status(path)
    if found is not None and not stat.S_ISREG(found.st_mode):
        if not os.access(path, os.W_OK):
            raise OutputError(f"{path}: cannot be written: {os.strerror(errno.EACCES)}")
        return Path(path)
    if found is not None and not os.access(path, os.W_OK):
        raise OutputError(f"{path}: cannot be written: the file is write-protected")
    target = _target(path)
    for parent in target.parents:
        if parent.is_dir():
            try:
                with tempfile.TemporaryFile(dir=parent):
                    break
            except OSError as error:
                if error.errno in DISK:
                    raise OSError(error.errno, os.strerror(error.errno), str(path)) from None
                raise OutputError(f"{path}: cannot be written: {parent}: {error.strerror}") from error
        if os.path.lexists(parent):
            raise OutputError(f"{path}: expected {parent} to be a folder, found a file")
    if len(os.fsencode(target.name)) > os.pathconf(_existing(target), "PC_NAME_MAX"):
        raise OutputError(f"{path}: cannot be written: the name is too long")
    return Path(path)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file in UTF-8; see :func:`write_bytes`."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write a file whole or not at all; a device or pipe is written to.

    Raises
    ------
    OutputError
        It cannot be written there.
    OSError
        The disk is full or fails; the error names the file asked for.
    """
    descriptor = _descriptor(path)
    if descriptor is not None:
        _to_descriptor(descriptor, data)
        return
    with _named(path):
        found = _status(path)
        if found is not None and not stat.S_ISREG(found.st_mode):
            with open(path, "wb", buffering=0) as device:
                _all(device.fileno(), data)
            return
    if not _without_a_name(path, data):
        with new_file(path) as partial, open(partial, "wb") as file:
            file.write(data)


@contextlib.contextmanager
def new_file(path: str | Path) -> Iterator[Path]:
    """Give a temporary name to write to; afterwards what is there is flushed to the disk and renamed to ``path``.

    The name ends as the file's own does. Where anything is raised, the temporary file is removed and an older file
    stays as it was.

    Raises
    ------
    OutputError
        It cannot be written there, or what is there is no regular file.
    OSError
        The disk is full or fails; the error names the file asked for.
    """
    partial: Path | None = None
    try:
        with _named(path):
            found = _status(path)
            if found is not None and not stat.S_ISREG(found.st_mode):
                raise OutputError(f"{path}: expected a regular file to write to, found a device or pipe")
            target = _target(path)
            target.parent.mkdir(parents=True, exist_ok=True)
            partial = target.with_name(_partial_name(target, uuid.uuid4().hex[:8]))
            os.close(os.open(partial, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
            yield partial
            if found is not None:
                os.chmod(partial, stat.S_IMODE(found.st_mode) & 0o777)
            with open(partial, "rb") as file:
                os.fsync(file.fileno())
            os.replace(partial, target)
            partial = None
            flush_folder(target.parent)
    finally:
        if partial is not None:
            partial.unlink(missing_ok=True)


def _without_a_name(path: str | Path, data: bytes) -> bool:
    """Write a file that has no name until it is whole, so that a killed process leaves nothing; False: not possible."""
    if not hasattr(os, "O_TMPFILE"):
        return False
    with _named(path), contextlib.ExitStack() as opened:
        target = _target(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            handle = os.open(target.parent, os.O_TMPFILE | os.O_WRONLY, 0o666)
            opened.callback(os.close, handle)
            folder = os.open(target.parent, os.O_RDONLY)  # naming one makes os.link follow the link in /proc
            opened.callback(os.close, folder)
        except OSError:  # the file system cannot
            return False
        _all(handle, data)
        if (found := _status(path)) is not None:
            os.fchmod(handle, stat.S_IMODE(found.st_mode) & 0o777)
        os.fsync(handle)
        partial = target.with_name(_partial_name(target, uuid.uuid4().hex[:8]))
        try:
            os.link(f"/proc/self/fd/{handle}", partial, src_dir_fd=folder, follow_symlinks=True)
        except OSError as error:
            if error.errno in DISK:
                raise
            return False  # no /proc, or a file system that cannot
        try:
            os.replace(partial, target)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise
        flush_folder(target.parent)
    return True


def _partial_name(target: Path, mark: str) -> str:
    return f".{target.stem[:64]}.{mark}.partial{target.suffix[:16]}"


def flush_folder(folder: Path) -> None:
    """Put a folder's own entries on the disk, where the system can."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _status(path: str | Path) -> os.stat_result | None:
    """What is there, links followed; None where there is nothing yet."""
    try:
        found = os.stat(path)
    except FileNotFoundError:
        return None
    except NotADirectoryError:
        for parent in Path(path).absolute().parents:
            if os.path.lexists(parent) and not parent.is_dir():
                raise OutputError(f"{path}: expected {parent} to be a folder, found a file") from None
        raise
    except (OSError, ValueError) as error:  # a loop of links, a name that is too long, a NUL in it
        raise OutputError(f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}") from error
    kind = KINDS.get(stat.S_IFMT(found.st_mode))
    if kind is not None:
        raise OutputError(f"{path}: expected a file to write to, found {kind}")
    return found


def _target(path: str | Path) -> Path:
    """The file itself, where a path is a link to it."""
    return Path(os.path.realpath(path))


def _existing(path: Path) -> Path:
    return next(parent for parent in path.parents if parent.is_dir())


@contextlib.contextmanager
def _named(path: str | Path) -> Iterator[None]:
    """Name the file asked for in an error, and not the temporary one."""
    try:
        yield
    except OSError as error:
        if error.errno in DISK:
            raise OSError(error.errno, os.strerror(error.errno), str(path)) from error
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error


def _descriptor(path: str | Path) -> int | None:
    """The open descriptor that ``/dev/stdout`` and its like stand for, else None."""
    match = re.fullmatch(r"/dev/(stdout|stderr)|/(?:dev|proc/self)/fd/(\d+)", os.path.abspath(path))
    if match is None:
        return None
    return {"stdout": 1, "stderr": 2}[match[1]] if match[1] else int(match[2])


def _to_descriptor(descriptor: int, data: bytes) -> None:
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, OSError, ValueError):  # closed or replaced by a test
            stream.flush()
    if descriptor == 1 and (buffer := getattr(sys.stdout, "buffer", None)) is not None:
        buffer.write(data)
        buffer.flush()
        return
    _all(descriptor, data)


def _all(descriptor: int, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(descriptor, view) :]
