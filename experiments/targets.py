"""Where an output may go: to a regular file, a device or a pipe; never onto an input, or something of another kind."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import stat
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path

from experiments.file_kinds import LOOKED_AT, Kind, kind_of

__all__ = [
    "DISK", "Kind", "OutputError", "check_folder", "check_output", "descriptor_of", "in_a_call", "is_forced",
    "is_stdout", "one_call", "protect", "real_path", "refuse_input", "refuse_other_kind", "status_of",
]  # fmt: skip

DISK = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG)
"""Errors of a disk and not of the call: they keep their own kind (exit code 1)."""
SPECIAL = {stat.S_IFBLK: "a block device", stat.S_IFSOCK: "a socket", stat.S_IFDIR: "a folder"}
READ_ENDINGS = frozenset({".csv", ".parquet", ".toml"})
"""What may be a part of a campaign folder."""


class OutputError(ValueError):
    """A file that cannot be written where it was asked for; the message names it."""


@dataclass
class _Call:
    """A call of the command: its inputs, and whether it may replace files of another kind."""

    inputs: list[Path]
    force: bool
    read: set[str] = field(default_factory=set)


_call: ContextVar[_Call | None] = ContextVar("call", default=None)


@contextmanager
def one_call(inputs: Iterable[Path], force: bool = False) -> Iterator[None]:
    """While it lasts, nothing is written onto ``inputs``, files in folders among them, or what was read meanwhile.

    Parameters
    ----------
    inputs
        Files and folders that the caller named to be read.
    force
        Files of another kind may be replaced.
    """
    token = _call.set(_Call(list(inputs), force))
    try:
        yield
    finally:
        _call.reset(token)


def protect(path: str | Path | None) -> None:
    """Mark a file as an input: this call will not write onto it. Without a call (in a notebook) it does nothing."""
    call = _call.get()
    if call is not None and path is not None:
        call.read.add(os.path.realpath(path))


def check_output(path: str | Path, kind: Kind | None = None) -> Path:
    """Check that a file can be written there, without writing it: to be called before long work.

    Parameters
    ----------
    path
        Where a file is to go. Folders that do not exist yet are made when it is written.
    kind
        Of what is to be written; None: not looked at.

    Raises
    ------
    OutputError
        There is a folder, a block device or a socket; it is an input of this call; something above is no folder;
        writing is not permitted; or there is a file of another kind, and the call does not say ``--force``.
    """
    if descriptor_of(path) is not None:
        return Path(path)
    found = status_of(path)
    refuse_input(path)
    if found is not None and not os.access(path, os.W_OK):
        raise OutputError(f"{path}: cannot be written: it is write-protected")
    if found is not None and not stat.S_ISREG(found.st_mode):
        return Path(path)
    target = real_path(path)
    _check_parent(path, target)
    if found is not None:
        refuse_other_kind(path, kind)
    return Path(path)


def check_folder(path: str | Path, *, kept: bool = False) -> Path:
    """Check that a folder can be made there, and take the place of one that is there: to be called before long work.

    Parameters
    ----------
    path
        Where a folder is to go.
    kept
        One that is there is written into and not replaced.

    Raises
    ------
    OutputError
        Something above is no folder, there is a file, writing is not permitted, or another file system is mounted
        there, so that nothing can be renamed to it.
    """
    target = real_path(path)
    _check_parent(path, target)
    if os.path.lexists(target) and not target.is_dir():
        raise OutputError(f"{path}: expected a folder to write to, found a file")
    if not kept and _is_mounted(target):
        raise OutputError(f"{path}: expected a folder that can be replaced, found a mount point; name one inside it")
    return Path(path)


def _is_mounted(folder: Path) -> bool:
    """Whether something is mounted there; of what is mounted twice from one file system only Linux's list says so."""
    if os.path.ismount(folder):
        return True
    with contextlib.suppress(OSError):
        lines = Path("/proc/self/mountinfo").read_bytes().splitlines()
        points = (re.sub(rb"\\([0-7]{3})", lambda m: bytes([int(m[1], 8)]), line.split()[4]) for line in lines)
        return os.fsencode(folder) in points
    return False


def refuse_input(path: str | Path) -> None:
    """Refuse to write onto something that this call reads.

    Raises
    ------
    OutputError
        It is one of the call's inputs, or what a campaign folder among them may consist of.
    """
    call = _call.get()
    if call is None:
        return
    target = real_path(path)
    if str(target) in call.read:
        raise OutputError(f"{path}: expected another file to write to, found one that this call reads")
    for one in call.inputs:
        with _quiet():
            if os.path.exists(target) and os.path.samefile(one, target):
                raise OutputError(f"{path}: expected another file to write to, found an input of this call")
            inside = one.is_dir() and target.is_relative_to(real_path(one))
            if inside and target.suffix.lower() in READ_ENDINGS:
                raise OutputError(f"{path}: expected a file outside {one}, which this call reads")


def status_of(path: str | Path) -> os.stat_result | None:
    """What is there, links followed; None where there is nothing yet.

    Raises
    ------
    OutputError
        Nothing can be written there: a folder, a block device, a socket, a loop of links, a name that is none.
    """
    try:
        found = os.stat(path)
    except FileNotFoundError:
        return None
    except NotADirectoryError:
        _check_parent(path, Path(path).absolute())
        raise
    except (OSError, ValueError) as error:
        raise OutputError(f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}") from error
    special = SPECIAL.get(stat.S_IFMT(found.st_mode))
    if special is not None:
        raise OutputError(f"{path}: expected a file to write to, found {special}")
    return found


def real_path(path: str | Path) -> Path:
    """The file itself, where a path is a link to it."""
    return Path(os.path.realpath(path))


def is_stdout(path: str | Path) -> bool:
    """Whether a path is another name of this process's standard output."""
    return descriptor_of(path) == 1


def descriptor_of(path: str | Path) -> int | None:
    """The open descriptor that ``/dev/stdout`` and its like stand for, else None."""
    match = re.fullmatch(r"/dev/(stdout|stderr)|/(?:dev|proc/self)/fd/(\d{1,9})", os.path.abspath(path))
    if match is None:
        return None
    return {"stdout": 1, "stderr": 2}[match[1]] if match[1] else int(match[2])


def _check_parent(path: str | Path, target: Path) -> None:
    for parent in target.parents:
        if parent.is_dir():
            break
        if os.path.lexists(parent):
            raise OutputError(f"{path}: expected {parent} to be a folder, found a file")
    else:
        raise OutputError(f"{path}: cannot be written: there is no folder above it")
    longest = os.pathconf(parent, "PC_NAME_MAX") if hasattr(os, "pathconf") else 255
    if any(len(os.fsencode(part)) > longest for part in target.relative_to(parent).parts):
        raise OutputError(f"{path}: cannot be written: File name too long")
    try:
        with tempfile.TemporaryFile(dir=parent):
            pass
    except OSError as error:
        if error.errno in DISK:
            raise OSError(error.errno, os.strerror(error.errno), str(path)) from None
        raise OutputError(f"{path}: cannot be written: {parent}: {error.strerror}") from error


def refuse_other_kind(path: str | Path, kind: str | None) -> None:
    """Refuse to replace a file by one of another kind, unless the call says ``--force``.

    Parameters
    ----------
    path
        Where a file is to go.
    kind
        Of what is to be written, as :func:`experiments.file_kinds.kind_of` names it; None: nothing is written.

    Raises
    ------
    OutputError
        There is a file of another kind.
    """
    if kind is None or is_forced():
        return
    try:
        with open(path, "rb") as file:
            found = kind_of(file.read(LOOKED_AT))
    except OSError:  # there is none, or it may be written and not read: its kind is unknown
        return
    if found is not None and found != kind:
        raise OutputError(f"{path}: expected {kind} to replace, found {found} (--force replaces it)")


def is_forced() -> bool:
    """Whether the call says ``--force``."""
    call = _call.get()
    return call is not None and call.force


def in_a_call() -> bool:
    """Whether a call of the command is at work, and not a notebook or a program."""
    return _call.get() is not None


@contextmanager
def _quiet() -> Iterator[None]:
    """Ignore an input that does not exist; others check that."""
    try:
        yield
    except OSError:
        return
