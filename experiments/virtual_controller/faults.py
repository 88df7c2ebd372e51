"""Faults on demand, by channel, as requested by ``--faults`` and the operator's line.

======================================  =============================================================================
``drop-after=[CHANNEL:][sent:]N``       the connection closes after N bytes received (or sent)
``stall=[CHANNEL:]SECONDS``             the channel neither reads nor answers, from the next byte on
``restart-at=SECONDS``                  the controller's programs are started anew, wall-clock seconds from now
``restart-at=point:N``                  likewise, in the middle of the move to point N of the next program
``overflow=CHANNEL``                    the interpreter takes nothing from the channel until its queues overflow
``split=N``                             every answer goes out in pieces of N bytes
``coalesce=N``                          answers go out N at a time (after 50 ms in any case)
``padding=N``                           N NUL bytes and line ends stand before every answer
======================================  =============================================================================

CHANNEL is ``motion`` (the default) or ``state``. The first four happen once; the others last until they are set to 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from experiments.virtual_controller.errors import ControllerError

__all__ = ["ChannelFaults", "Fault", "parse_faults"]

Channel = Literal["motion", "state"]
CHANNELS: tuple[Channel, ...] = ("motion", "state")
NAMES = ("drop-after", "stall", "restart-at", "overflow", "split", "coalesce", "padding")
ON_CHANNEL = ("drop-after", "stall", "overflow")
MAX_SIZE = 10_000_000


@dataclass(frozen=True)
class Fault:
    """One fault as asked for.

    Attributes
    ----------
    name
        One of `NAMES`.
    channel
        Where it happens, for those that happen on one channel.
    value
        Seconds, bytes, or a count.
    sent
        Bytes sent are counted, not those received.
    point
        ``value`` is a point's number.
    """

    name: str
    channel: Channel = "motion"
    value: float = 0.0
    sent: bool = False
    point: bool = False


@dataclass
class ChannelFaults:
    """The faults that are armed on one channel."""

    drop_received: int | None = None  # bytes left
    drop_sent: int | None = None
    stall: float = 0.0  # s
    overflow: bool = False
    split: int = 0
    coalesce: int = 0
    padding: int = 0

    def arm(self, fault: Fault) -> None:
        """Arm a fault."""
        size = int(fault.value)
        if fault.name == "drop-after":
            if fault.sent:
                self.drop_sent = size
            else:
                self.drop_received = size
        elif fault.name == "stall":
            self.stall = fault.value
        elif fault.name == "overflow":
            self.overflow = True
        else:
            setattr(self, fault.name, size)


def parse_faults(items: Sequence[str]) -> list[Fault]:
    """Read faults: ``NAME=VALUE``, several of them separated by commas.

    Raises
    ------
    ControllerError
        One of them is not known, or its value is out of range.
    """
    return [_fault(part.strip()) for item in items for part in item.split(",") if part.strip()]


def _fault(text: str) -> Fault:
    name, equals, value = text.partition("=")
    if name not in NAMES or not equals:
        raise ControllerError(f"fault {text!r}: expected NAME=VALUE with a NAME of {', '.join(NAMES)}")
    channel: Channel = "motion"
    if name in ON_CHANNEL:
        for each in CHANNELS:
            if value == each or value.startswith(f"{each}:"):
                channel, value = each, value[len(each) + 1 :]
    if name == "overflow":
        if value:
            raise ControllerError(f"fault {text!r}: expected overflow={' or overflow='.join(CHANNELS)}")
        return Fault(name, channel)
    word = "sent:" if name == "drop-after" else "point:" if name == "restart-at" else ""
    marked = bool(word) and value.startswith(word)
    number = value.removeprefix(word) if marked else value
    if name == "drop-after" and not marked:
        number = number.removeprefix("received:")
    try:
        size = float(number) if name in ("stall", "restart-at") and not marked else float(int(number))
    except ValueError:
        size = -1.0
    if not 0.0 <= size <= MAX_SIZE:
        raise ControllerError(f"fault {text!r}: expected a number from 0 to {MAX_SIZE}, found {number!r}")
    return Fault(name, channel, size, sent=marked and name == "drop-after", point=marked and name == "restart-at")
