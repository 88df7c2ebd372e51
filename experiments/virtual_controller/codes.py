"""The numbers of the documents: events, reasons, kinds of questions, operating modes."""

from __future__ import annotations

from enum import IntEnum

__all__ = ["Event", "Kind", "Mode", "Reason"]


class Event(IntEnum):
    """What is said of a program."""

    ACCEPTED = 1
    POINT = 2
    FINISHED = 3
    REFUSED = 4
    ABORTED = 5


class Reason(IntEnum):
    """Why a program was refused or aborted."""

    NONE = 0
    BOOT = 1
    ID = 2
    POINTS = 3
    RANGE = 4
    SPEED = 5
    LATCH = 6
    EMERGENCY = 7
    MODE = 8
    DRIVES = 9
    WATCHDOG = 10
    CLOSED = 11
    BUSY = 12


class Kind(IntEnum):
    """What a question asks for."""

    STATE = 0
    STOP = 1
    RELEASE = 2
    RECORDING = 3


class Mode(IntEnum):
    """Operating modes; programs from outside run in the last two."""

    T1 = 1
    T2 = 2
    AUT = 3
    EXT = 4
