"""Writes files: complete and on the disk, or not at all. Every file that the program writes goes through here.

A regular file is written without a name or under a temporary one beside it, flushed to the disk, and renamed. Links are
followed. Devices, pipes and ``/dev/stdout`` are written to directly, because a rename would replace them.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import os
import platform
import shutil
import stat
import sys
import tempfile
import uuid
from collections.abc import Iterator
from pathlib import Path

from experiments.file_kinds import LOOKED_AT, kind_of
from experiments.targets import (
    DISK,
    OutputError,
    descriptor_of,
    in_a_call,
    real_path,
    refuse_input,
    refuse_other_kind,
    status_of,
)

__all__ = [
    "OutputError", "flush_folder", "naming", "new_file", "new_folder", "scratch_folder", "temporary_folder",
    "write_bytes", "write_text",
]  # fmt: skip

AT_CWD, RENAME_EXCHANGE = -100, 2  # of linux/fcntl.h and linux/fs.h


def write_text(path: str | Path, text: str) -> None:
    """Write a text file in UTF-8; see :func:`write_bytes`."""
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write a file whole or not at all; a device or pipe is written to.

    Raises
    ------
    OutputError
        It cannot be written there, this call reads it, or what is there is of another kind and the call of the command
        does not say ``--force``.
    OSError
        The disk is full or fails; the error names the file asked for.
    """
    descriptor = descriptor_of(path)
    if descriptor is not None:
        with naming(path):
            _to_descriptor(descriptor, data)
        return
    refuse_input(path)
    found = status_of(path)
    if found is not None and not stat.S_ISREG(found.st_mode):
        with naming(path), open(path, "wb", buffering=0) as device:
            _all(device.fileno(), data)
        return
    if in_a_call():
        refuse_other_kind(path, kind_of(data[:LOOKED_AT]))
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
        It cannot be written there, what is there is no regular file, or this call reads it.
    OSError
        The disk is full or fails; the error names the file asked for.
    """
    partial: Path | None = None
    refuse_input(path)
    found = status_of(path)
    if found is not None and not stat.S_ISREG(found.st_mode):
        raise OutputError(f"{path}: expected a regular file to write to, found a device or pipe")
    try:
        with naming(path):
            target = real_path(path)
            target.parent.mkdir(parents=True, exist_ok=True)
            _remove_left_over(target)
            partial = target.with_name(_partial_name(target))
            os.close(os.open(partial, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
            yield partial
            if found is not None:
                os.chmod(partial, stat.S_IMODE(found.st_mode) & 0o777)
            _flush_file(partial)
            os.replace(partial, target)
            partial = None
            flush_folder(target.parent)
    finally:
        if partial is not None:
            partial.unlink(missing_ok=True)


def flush_folder(folder: Path) -> None:
    """Put a folder's own entries on the disk, where the system can."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Give a temporary folder to fill; afterwards it is flushed to the disk and takes the place of ``path``.

    Raises
    ------
    OutputError
        It cannot be written there, or a folder that is not empty has appeared there meanwhile.
    OSError
        The disk is full or fails; the error names the folder asked for.
    """
    there = path.exists()
    with naming(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with scratch_folder(path.parent, path.name) as partial:
            yield partial
            _flush_tree(partial)
            if not there:
                partial.rename(path)
            elif not _exchange(partial, path):
                old = path.parent / f"{partial.name}.old"  # stays if the process is killed before the second rename
                path.rename(old)
                try:
                    partial.rename(path)
                except OSError:
                    old.rename(path)
                    raise
                shutil.rmtree(old)
            flush_folder(path.parent)


@contextlib.contextmanager
def scratch_folder(parent: Path, name: str) -> Iterator[Path]:
    """Make a folder that is removed at the end; one of a process that was killed is removed by the next one."""
    _remove_left_over(parent / name)
    partial = parent / _partial_name(parent / name)
    try:
        partial.mkdir(mode=0o777)
        yield partial
    finally:
        shutil.rmtree(partial, ignore_errors=True)


@contextlib.contextmanager
def temporary_folder() -> Iterator[Path]:
    """Give a folder in the system's place for temporary files; where its disk is full, the error names that place."""
    place = tempfile.gettempdir()
    try:
        with tempfile.TemporaryDirectory() as folder:
            yield Path(folder)
    except OSError as error:
        if error.errno in DISK and str(error.filename or place).startswith(place):
            raise OSError(error.errno, os.strerror(error.errno), place) from error
        raise


def _exchange(one: Path, other: Path) -> bool:
    """Let two folders change places at once, where the system can (Linux: renameat2)."""
    rename = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None) if os.name == "posix" else None
    return rename is not None and rename(AT_CWD, os.fsencode(one), AT_CWD, os.fsencode(other), RENAME_EXCHANGE) == 0


def _flush_tree(folder: Path) -> None:
    """Put a folder with all that is in it on the disk, before it is renamed to its place."""
    for place, _, files in os.walk(folder):
        for name in files:
            _flush_file(Path(place) / name)
        flush_folder(Path(place))


@contextlib.contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Name what was asked for in an error, and not a temporary name.

    Raises
    ------
    OutputError
        Instead of an error of the call's (no permission, no such place).
    OSError
        The disk is full or fails.
    """
    try:
        yield
    except OSError as error:
        if error.errno in DISK:
            raise OSError(error.errno, os.strerror(error.errno), str(path)) from error
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error


def _without_a_name(path: str | Path, data: bytes) -> bool:
    """Write a file that has no name until it is whole, so that a killed process leaves nothing; False: not possible."""
    if not hasattr(os, "O_TMPFILE"):
        return False
    with naming(path), contextlib.ExitStack() as opened:
        target = real_path(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            handle = os.open(target.parent, os.O_TMPFILE | os.O_WRONLY, 0o666)
            opened.callback(os.close, handle)
            folder = os.open(target.parent, os.O_RDONLY)  # naming one makes os.link follow the link in /proc
            opened.callback(os.close, folder)
        except OSError:  # the file system cannot
            return False
        _all(handle, data)
        if (found := status_of(path)) is not None:
            os.fchmod(handle, stat.S_IMODE(found.st_mode) & 0o777)
        os.fsync(handle)
        _remove_left_over(target)
        partial = target.with_name(_partial_name(target))
        try:
            if found is None:
                with contextlib.suppress(FileExistsError):  # somebody else was faster: then as with an older one
                    os.link(f"/proc/self/fd/{handle}", target, src_dir_fd=folder, follow_symlinks=True)
                    flush_folder(target.parent)
                    return True
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


def _partial_name(target: Path) -> str:
    return f".{target.stem[:64]}.{os.getpid()}-{_host()}-{uuid.uuid4().hex[:8]}.partial{target.suffix[:16]}"


def _remove_left_over(target: Path) -> None:
    """Remove what processes that were killed while they wrote this file have left beside it."""
    ending = f".partial{target.suffix[:16]}"
    with contextlib.suppress(OSError):
        for entry in os.scandir(target.parent):
            if not (entry.name.startswith(f".{target.stem[:64]}.") and entry.name.endswith(ending)):
                continue
            number, _, rest = entry.name.removesuffix(ending).rpartition(".")[2].partition("-")
            if number.isdigit() and rest.partition("-")[0] == _host() and not _runs(int(number)):
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.path, ignore_errors=True)
                else:
                    Path(entry.path).unlink(missing_ok=True)


@functools.cache
def _host() -> str:
    """A mark of this machine: what another one writes in a shared folder is not looked at."""
    return hashlib.sha256(platform.node().encode()).hexdigest()[:6]


def _runs(process: int) -> bool:
    """Whether a process of this number is there; its number may be another's by now, and then its file stays."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def _flush_file(path: Path) -> None:
    with open(path, "rb") as file:
        os.fsync(file.fileno())


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
