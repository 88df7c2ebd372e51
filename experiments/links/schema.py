"""The schema of the two EthernetKRL channels: tags, types and limits of every document.

The config files, the KRL programs, the client and the virtual controller are all made from this schema, so a change
here changes both sides. The units on the wire are the controller's: degrees, percent, kelvin, ms.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

__all__ = [
    "ALIVE_FLAGS",
    "AXES",
    "CHANNELS",
    "DATA_FLAGS",
    "LONGEST_PROGRAM",
    "MOTION",
    "PORT",
    "RING",
    "SAMPLES",
    "SAMPLE_MS",
    "STATE",
    "WATCHDOG_S",
    "Channel",
    "Element",
    "Event",
    "Kind",
    "Mode",
    "Reason",
    "Type",
    "document",
]

Type = Literal["INT", "REAL", "BOOL"]

AXES = 6
PORT = 54600
"""Of the motion channel; the state channel has the next one. EthernetKRL offers 54600 to 54615."""
LONGEST_PROGRAM = 60  # points: fewer than what a channel's buffers hold
SAMPLES = 4  # of the recording in one answer
RING = 20_000  # samples that the controller keeps
SAMPLE_MS = 12  # between two samples: the cycle of the submit interpreter
WATCHDOG_S = 2.0  # without any Ask, after which a running program is aborted
ALIVE_FLAGS = (995, 997)
"""$FLAG that is set while a client is connected: of the motion channel, of the state channel."""
DATA_FLAGS = (996, 998)
"""$FLAG that EthernetKRL sets when a whole document has come: likewise."""


class Event(IntEnum):
    """What a `Moved` document says."""

    ACCEPTED = 1
    POINT = 2
    FINISHED = 3
    REFUSED = 4
    ABORTED = 5


class Reason(IntEnum):
    """Why a program was refused or aborted."""

    NONE = 0
    WRONG_BOOT = 1
    ID_NOT_NEW = 2
    POINTS = 3
    AXIS_LIMIT = 4
    SPEED = 5
    STOPPED = 6
    EMERGENCY_STOP = 7
    MODE = 8
    DRIVES_OFF = 9
    WATCHDOG = 10
    CLOSED = 11
    RUNNING = 12

    @property
    def words(self) -> str:
        """For people."""
        return _WORDS[self]


_WORDS: Mapping[Reason, str] = {
    Reason.NONE: "no reason given",
    Reason.WRONG_BOOT: "the controller's programs were started again meanwhile",
    Reason.ID_NOT_NEW: "the program's number is not new",
    Reason.POINTS: "points are missing or out of order",
    Reason.AXIS_LIMIT: "a point is beyond an axis limit",
    Reason.SPEED: "the speed is not above 0 and at most 100 %",
    Reason.STOPPED: "the robot was stopped",
    Reason.EMERGENCY_STOP: "emergency stop",
    Reason.MODE: "the operating mode is not AUT or EXT",
    Reason.DRIVES_OFF: "the drives are off",
    Reason.WATCHDOG: "the controller had not been asked for its state for 2 s",
    Reason.CLOSED: "the connection closed before the program was whole",
    Reason.RUNNING: "another program is running",
}


class Kind(IntEnum):
    """What an `Ask` document wants; the answer is a whole `Robot` document each time."""

    STATE = 0
    STOP = 1
    RELEASE = 2
    RECORDING = 3


class Mode(IntEnum):
    """The operating mode."""

    T1 = 1
    T2 = 2
    AUT = 3
    EXT = 4


@dataclass(frozen=True)
class Element:
    """One value of a document.

    Attributes
    ----------
    tag
        As EthernetKRL addresses it: ``Move/Axis/@A1`` is the attribute A1 of Axis in the root element Move.
    type
        Of the value in KRL.
    unit
        On the wire.
    """

    tag: str
    type: Type
    unit: str = ""

    @property
    def root(self) -> str:
        """The root element."""
        return self.tag.partition("/")[0]


@dataclass(frozen=True)
class Channel:
    """One connection: the controller is the server and takes one client.

    Attributes
    ----------
    name
        Of the config file, of at most 24 characters.
    environment
        Which interpreter opens it.
    offset
        Its port is the first one plus this.
    limit
        Values that the controller stores for each element; one more closes the connection.
    buffer
        Bytes that it stores before they are read as XML.
    receive, send
        What the controller receives and sends, in order.
    """

    name: str
    environment: Literal["Program", "Submit"]
    offset: int
    limit: int
    buffer: int
    receive: tuple[Element, ...]
    send: tuple[Element, ...]


def _attributes(at: str, names: str, type_: Type, unit: str = "") -> Iterator[Element]:
    for name in names.split():
        yield Element(f"{at}/@{name}", type_, unit)


def _children(at: str, names: str, type_: Type) -> Iterator[Element]:
    for name in names.split():
        yield Element(f"{at}/{name}", type_)


_A = " ".join(f"A{k}" for k in range(1, AXES + 1))


def _sample(k: int) -> Iterator[Element]:
    at = f"Robot/S{k}"
    yield Element(f"{at}/@N", "INT")
    yield Element(f"{at}/@T", "INT", "ms")
    for letter, unit in (("Q", "deg"), ("M", "setting"), ("I", "setting")):
        yield from _attributes(at, " ".join(f"{letter}{i}" for i in range(1, AXES + 1)), "REAL", unit)


MOTION = Channel(
    name="ClampidMotion",
    environment="Program",
    offset=0,
    limit=64,
    buffer=32768,
    receive=(
        *_children("Move", "Boot Id Point Count", "INT"),
        Element("Move/Speed", "REAL", "%"),
        *_attributes("Move/Axis", _A, "REAL", "deg"),
    ),
    send=tuple(_children("Moved", "Boot Event Id Point Reason", "INT")),
)
STATE = Channel(
    name="ClampidState",
    environment="Submit",
    offset=1,
    limit=16,
    buffer=16384,
    receive=tuple(_children("Ask", "Sequence Kind From", "INT")),
    send=(
        *_attributes("Robot/State", "Sequence Boot Accepted Running Finished Aborted Point Reason", "INT"),
        Element("Robot/State/@Stopped", "BOOL"),
        Element("Robot/State/@Mode", "INT"),
        *_attributes("Robot/State", "Drives Brakes Estop", "BOOL"),
        Element("Robot/State/@Clock", "INT", "ms"),
        *_attributes("Robot/State", "Oldest Newest", "INT"),
        *_attributes("Robot/Axis", _A, "REAL", "deg"),
        *_attributes("Robot/Torque", _A, "REAL", "setting"),
        *_attributes("Robot/Current", _A, "REAL", "setting"),
        *_attributes("Robot/Temperature", _A, "REAL", "K"),
        Element("Robot/Samples/@Count", "INT"),
        *(element for k in range(1, SAMPLES + 1) for element in _sample(k)),
    ),
)
CHANNELS = (MOTION, STATE)


def document(elements: tuple[Element, ...], values: Mapping[str, float | bool]) -> bytes:
    """Write one document with every element, as EthernetKRL does: no prolog, explicit closing tags.

    Parameters
    ----------
    elements
        Of one root element, in order.
    values
        By tag, in the units of the wire.

    Returns
    -------
    bytes
        ASCII. REAL has nine significant digits: all that a four-byte float holds.
    """
    root = elements[0].root
    out = [f"<{root}"]
    at, open_tag = "", True  # the child that is being written; whether its opening tag is still open
    for element in elements:
        path = element.tag.split("/")[1:]
        text = _text(element.type, values[element.tag])
        if path[-1].startswith("@"):
            child = path[0] if len(path) == 2 else ""
            if child != at:
                out.append(f"{_end(at, open_tag)}<{child}")
                at, open_tag = child, True
            out.append(f' {path[-1][1:]}="{text}"')
        else:
            out.append(f"{_end(at, open_tag)}<{path[0]}>{text}</{path[0]}>")
            at, open_tag = "", False
    return ("".join(out) + _end(at, open_tag) + f"</{root}>").encode("ascii")


def _end(at: str, open_tag: bool) -> str:
    """What closes the child that was being written; of the root, its opening tag."""
    return ("></" + at + ">") if at else (">" if open_tag else "")


def _text(type_: Type, value: float | bool) -> str:
    if type_ == "REAL":
        return f"{value:.9g}"
    return str(int(value))
