"""The true values, for evaluation: the hidden effects, and the result of every program.

``FILE.json`` says what is hidden. ``FILE.journal.jsonl`` beside it has a line for every event, each written whole with
one call, so that a process that is killed leaves no half of one. A controller that is started again with the same file
goes on there: its boot number is the next one, and the robot stands where it was seen last.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.outputs import write_text
from experiments.virtual_controller.errors import ControllerError

__all__ = ["Journal", "journal_file"]

AXES = 6
MAX_BYTES = 200_000_000  # of a journal: weeks of moves
MAX_BOOT = 2**31 - 1  # an INT of KRL
MAX_DEG = 3600.0  # of an axis: ten turns


def journal_file(truth: Path) -> Path:
    """Return where the events of a truth file are."""
    return truth.with_name(f"{truth.stem}.journal.jsonl")


class Journal:
    """Writes the truth of one controller.

    Parameters
    ----------
    truth
        The file; None: nothing is kept.
    robot, seed
        Which individual.
    asked
        What was to be hidden, as it was asked for.

    Raises
    ------
    ControllerError
        The file is of another robot.
    """

    def __init__(self, truth: Path | None, robot: str, seed: int, asked: Sequence[str]) -> None:
        self._truth = truth
        self._descriptor: int | None = None
        self._individual: dict[str, Any] = {"robot": robot, "seed": seed, "asked": list(asked)}
        self.boot = 1
        self.posture: list[float] | None = None  # deg
        if truth is not None and truth.exists():
            self._go_on(truth)

    def _go_on(self, truth: Path) -> None:
        try:
            found = json.loads(_text(truth))
        except (OSError, ValueError, RecursionError) as error:
            raise ControllerError(f"{truth}: expected the truth of a virtual robot, found none: {error}") from None
        individual = {key: found.get(key) if isinstance(found, dict) else None for key in self._individual}
        if individual != self._individual:
            raise ControllerError(f"{truth}: expected the truth of {self._individual}, found that of {individual}")
        for event in read_events(truth):
            self.boot = max(self.boot, event["boot"] + 1)
            self.posture = event.get("at", self.posture)

    def begin(self, hidden: Sequence[Mapping[str, Any]], more: Mapping[str, Any]) -> None:
        """Write the truth file, and say in the journal that the controller is there."""
        if self._truth is None:
            return
        file = journal_file(self._truth)
        individual = self._individual | {"hidden": list(hidden), **more, "journal": file.name}
        write_text(self._truth, json.dumps(individual, indent=1) + "\n")
        self._descriptor = os.open(file, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        if file.stat().st_size and not file.read_bytes().endswith(b"\n"):
            os.write(self._descriptor, b"\n")  # a line that a full disk cut

    def add(self, event: Mapping[str, Any]) -> None:
        """Append an event.

        Raises
        ------
        ControllerError
            The disk does not take all of it.
        """
        if self._descriptor is None or self._truth is None:
            return
        line = json.dumps(event, separators=(",", ":")).encode() + b"\n"
        try:
            why = "" if os.write(self._descriptor, line) == len(line) else "the disk is full"
        except OSError as error:
            why = error.strerror or str(error)
        if why:
            raise ControllerError(f"{journal_file(self._truth)}: cannot be written: {why}")

    def close(self) -> None:
        """Close the journal."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None


def read_events(truth: Path) -> list[dict[str, Any]]:
    """Return the events of a truth file's journal in order; a line that was cut is left out.

    Raises
    ------
    ControllerError
        The journal cannot be read, or a whole line of it is no event.
    """
    file = journal_file(truth)
    try:
        lines = _text(file).splitlines() if file.exists() else []
    except (OSError, UnicodeDecodeError) as error:
        raise ControllerError(f"{file}: cannot be read: {error}") from None
    events = []
    for number, line in enumerate(lines, 1):
        try:
            event = json.loads(line)
        except (ValueError, RecursionError):
            continue
        if isinstance(event, dict) and "boot" in event:
            if not _is_event(event):
                raise ControllerError(f"{file}, line {number}: expected an event of a virtual robot, found another")
            events.append(event)
    return events


def _text(file: Path) -> str:
    """A file's text; one that is no regular file, or longer than could be meant, is an OSError."""
    if not file.is_file():
        raise OSError("expected a regular file")
    with file.open("rb") as opened:
        data = opened.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise OSError(f"expected at most {MAX_BYTES} bytes")
    return data.decode("utf-8")


def _is_event(event: Mapping[str, Any]) -> bool:
    """Whether boot number and posture, which a controller goes on from, can be meant."""
    boot, at = event["boot"], event.get("at", [0.0] * AXES)
    whole = isinstance(boot, int) and not isinstance(boot, bool) and 0 < boot < MAX_BOOT
    axes = isinstance(at, list) and len(at) == AXES and all(type(x) in (int, float) and abs(x) <= MAX_DEG for x in at)
    return whole and axes
