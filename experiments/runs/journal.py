"""The journal of a run: one line for each thing that happened, on the disk before the next one begins.

A line is eight hexadecimal digits (CRC-32 of the rest), a blank, and a JSON object. A process that is killed, or a
power cut, leaves at most one line that is not whole. It is dropped when the journal is opened again, and
its step is measured again.
"""

from __future__ import annotations

import contextlib
import json
import os
import stat
import time
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from experiments.outputs import flush_folder
from experiments.plans.errors import PlanError
from kinematics.reading import json_of

__all__ = ["Journal", "line_of", "whole_lines"]

Entry = Mapping[str, Any]
MOTION = ("move", "sent", "moved")


def line_of(entry: Entry) -> bytes:
    """One line of a journal."""
    text = json.dumps(entry, allow_nan=False, separators=(",", ":")).encode("ascii")
    return b"%08x %s\n" % (zlib.crc32(text), text)


def whole_lines(data: bytes) -> tuple[list[dict[str, Any]], int]:
    """What stands in a journal, and after how many bytes the last whole line ends."""
    entries: list[dict[str, Any]] = []
    end = 0
    for line in data.splitlines(keepends=True):
        entry = _entry(line)
        if entry is None:
            break
        entries.append(entry)
        end += len(line)
    return entries, end


def _entry(line: bytes) -> dict[str, Any] | None:
    check, blank, text = line[:8], line[8:9], line[9:-1]
    if not line.endswith(b"\n") or blank != b" " or check != b"%08x" % zlib.crc32(text):
        return None
    try:
        entry = json_of(text.decode("ascii"))
    except ValueError:  # right by its checksum, and yet nothing that a run wrote
        return None
    return entry if isinstance(entry, dict) and isinstance(entry.get("what"), str) else None


class Journal:
    """A journal that is open for adding; one process at a time.

    Parameters
    ----------
    path
        The file; it is made if it does not exist.

    Raises
    ------
    PlanError
        It is no regular file, another process has it open, or more than its last line is damaged: no killed process
        does that.

    Attributes
    ----------
    entries
        What stands in it; of motions that follow each other only the last one.
    dropped
        Bytes of a line that was not whole, which were cut off.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
        try:
            _lock(self._file, path)
            if not stat.S_ISREG(os.fstat(self._file).st_mode):
                raise PlanError(f"{path}: expected a regular file, found another kind")
            data = path.read_bytes()
            found, end = whole_lines(data)
            rest = data[end:]
            if any(_entry(line) is not None for line in rest.splitlines(keepends=True)[1:]):
                raise PlanError(
                    f"{path}: expected whole lines, found line {len(found) + 1} damaged with whole ones after it"
                )
            if b"\n" in rest[:-1]:
                raise PlanError(f"{path}: expected whole lines, found more than the last one damaged")
            self.entries: list[dict[str, Any]] = []
            for entry in found:
                self._remember(entry)
            self.dropped = len(rest)
            if rest:
                os.ftruncate(self._file, end)
                os.fsync(self._file)
            flush_folder(path.parent)
        except BaseException:
            os.close(self._file)
            raise

    def add(self, what: str, **content: Any) -> dict[str, Any]:
        """Write one line; when this returns it is on the disk.

        Raises
        ------
        OSError
            The disk takes no more; what was written of the line is cut off again.
        """
        entry = {"what": what, "wall": round(time.time(), 3), **content}
        data = line_of(entry)
        size = os.fstat(self._file).st_size
        try:
            view = memoryview(data)
            while view:
                view = view[os.write(self._file, view) :]
            os.fsync(self._file)
        except BaseException:
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, size)
            raise
        self._remember(entry)
        return entry

    def _remember(self, entry: dict[str, Any]) -> None:
        """Keep an entry in memory; of motions one after the other only the last, for hours of swings are all alike."""
        if entry["what"] == "move":
            while self.entries and self.entries[-1]["what"] in MOTION:
                self.entries.pop()
        self.entries.append(entry)

    def of(self, what: str) -> Iterator[dict[str, Any]]:
        """Entries of one kind, in order."""
        return (entry for entry in self.entries if entry["what"] == what)

    def close(self) -> None:
        """Let another process have it."""
        os.close(self._file)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _lock(file: int, path: Path) -> None:
    """Keep other processes out, where the system can; the lock ends with the process."""
    try:
        import fcntl
    except ImportError:  # Windows
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise PlanError(f"{path}: expected no other run of this campaign, found one that is going on") from None
