"""A read-only stream of KUKA.RobotSensorInterface: ``rsi://HOST:PORT`` listens there, and never answers.

Each datagram is one ``Rob`` document with the controller's clock, ``IPOC`` in ms. A step of more than one cycle is a
gap that is counted and shown. ``Delay`` is the controller's own count of late packets.
"""

from __future__ import annotations

import contextlib
import re
import socket
import threading
import time
from collections import deque
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from experiments.links.address import LinkAddress
from experiments.links.protocol import (
    Capabilities,
    LinkLostError,
    Recording,
    Signal,
    Status,
)
from experiments.links.read_only import ReadOnly
from experiments.links.rsi_config import GEAR
from experiments.links.schema import AXES, Element
from experiments.links.splitter import Splitter, StreamError, values_of
from experiments.links.turning import SHORTEST_STATUS_INTERVAL, turns

__all__ = ["Cycle", "RsiCounts", "RsiLink", "connect", "cycle_of"]

Array = npt.NDArray[np.float64]

FIRST_DATAGRAM_TIMEOUT = 3.0  # s within which the first datagram has to come
LARGEST_DATAGRAM = 4096  # bytes of a datagram; others are cut, and then malformed
CYCLES_KEPT = 20_000  # cycles: 80 s at 4 ms
CYCLES = ("4", "12")  # ms
LISTENS_ONLY = "an RSI stream with ONLYSEND listens only"
_NAN = np.full(AXES, np.nan)


@dataclass(frozen=True, eq=False)
class Cycle:
    """What one datagram says.

    Attributes
    ----------
    ipoc
        The controller's clock, ms.
    joints, set_points
        Measured and commanded ``(6,)``, rad; nan where they are not sent.
    current
        ``(6,)`` as the controller gives it; nan where it is not sent.
    gear_torque
        At the gears ``(6,)``, Nm; nan where it is not sent. Never to be mixed with torques of motors.
    delay
        Late packets as the controller counts them.
    """

    ipoc: int
    joints: Array
    set_points: Array
    current: Array
    gear_torque: Array
    delay: int


@dataclass
class RsiCounts:
    """What came, and what did not.

    Attributes
    ----------
    received
        Datagrams that were read.
    malformed, foreign, late
        Dropped: no such document, of another sender than the first, older than one that came before.
    missing
        Cycles that never came, by the clock.
    gaps
        First and last missing IPOC of the last gaps, ms.
    """

    received: int = 0
    malformed: int = 0
    foreign: int = 0
    late: int = 0
    missing: int = 0
    gaps: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=1000))


class RsiLink(ReadOnly):
    """Listens in a thread of its own.

    Parameters
    ----------
    host, port
        Where to listen; port 0: any.
    cycle
        Of the controller, ms: 4 or 12.
    """

    why = LISTENS_ONLY

    def __init__(self, host: str, port: int, cycle: int = 4) -> None:
        period = cycle / 1000
        clock = "controller, IPOC"
        self.capabilities = Capabilities(
            scheme="rsi",
            records=True,
            signals=(
                Signal("joint", "rad", "joint", "measured", clock, period),
                Signal("set_point", "rad", "joint", "set point", clock, period),
                Signal("current", "% of the greatest, by one manual", "motor", "measured", clock, period),
                Signal("torque", "Nm", "gear", "measured", clock, period),
            ),
            cannot=(
                f"Move, stop or release: {LISTENS_ONLY}.",
                "Temperatures, mode and brakes: they are not in the stream.",
                "What was lost on the way: the controller keeps no samples.",
            ),
        )
        self.counts, self.cycle = RsiCounts(), cycle
        self._kept: deque[Cycle] = deque(maxlen=CYCLES_KEPT)
        self._lock = threading.Lock()
        self._came = threading.Condition(self._lock)
        self._received, self._sender = 0.0, ""
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise LinkLostError(f"rsi: cannot listen at {host}:{port}: {error.strerror or error}") from None
        self._socket.settimeout(0.2)
        self.port: int = self._socket.getsockname()[1]
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="rsi", daemon=True)
        self._thread.start()

    def status(self) -> Status:
        """The last cycle as a status; see `Link`. Its torque is at the gears."""
        with self._lock:
            if not self._kept:
                raise LinkLostError("rsi: no datagram has come yet")
            last, received = self._kept[-1], self._received
            older = (one for one in reversed(self._kept) if last.ipoc - one.ipoc >= 1000 * SHORTEST_STATUS_INTERVAL)
            before = next(older, None)
        return Status(
            joints=last.joints,
            clock=last.ipoc / 1000,
            torque=last.gear_torque,
            current=last.current,
            newest=last.ipoc // self.cycle,
            moves=None if before is None else turns(before.joints, last.joints, (last.ipoc - before.ipoc) / 1000),
            received=received,
        )

    def cycles(self) -> tuple[Cycle, ...]:
        """All cycles that are kept, in order."""
        with self._lock:
            return tuple(self._kept)

    def recording(self, start: int, most: int = 1000, patience: float = 5.0) -> Recording:
        """Cycles from a number on; the number is IPOC over the cycle. See `Link`."""
        with self._came:
            self._came.wait_for(lambda: bool(self._kept) and self._kept[-1].ipoc // self.cycle >= start, patience)
            kept = [one for one in self._kept if one.ipoc // self.cycle >= start][:most]
            if not self._kept:
                raise LinkLostError("rsi: no datagram has come yet")
            oldest, newest = self._kept[0].ipoc // self.cycle, self._kept[-1].ipoc // self.cycle
        number = np.array([one.ipoc // self.cycle for one in kept], dtype=np.int64)

        def rows(name: str) -> Array:
            return np.array([getattr(one, name) for one in kept], dtype=np.float64).reshape(-1, AXES)

        times = np.array([one.ipoc / 1000 for one in kept], dtype=np.float64)
        lost = (start, oldest - 1) if start < oldest else None
        return Recording(number, times, rows("joints"), rows("gear_torque"), rows("current"), lost, newest)

    def close(self) -> None:
        """Stop listening; see `Link`."""
        self._closing = True
        self._thread.join(2.0)
        self._socket.close()

    def _run(self) -> None:
        while not self._closing:
            with contextlib.suppress(OSError):  # a time-out, or an ICMP message of the past
                data, sender = self._socket.recvfrom(LARGEST_DATAGRAM)
                self.take(data, str(sender[0]))

    def take(self, data: bytes, sender: str) -> None:
        """Take one datagram; whatever it is, it is counted."""
        with self._came:
            if self._sender not in ("", sender):
                self.counts.foreign += 1
                return
            try:
                found = cycle_of(data)
            except StreamError:
                self.counts.malformed += 1
                return
            self._sender = sender
            self.counts.received += 1
            if self._kept:
                step = found.ipoc - self._kept[-1].ipoc
                restarted = (
                    step < -1000 * FIRST_DATAGRAM_TIMEOUT or time.monotonic() - self._received > FIRST_DATAGRAM_TIMEOUT
                )
                if step <= 0 and not restarted:
                    self.counts.late += 1
                    return
                if restarted and step <= 0:
                    self._kept.clear()  # the stream began anew: its clock too
                elif step > self.cycle:
                    self.counts.missing += step // self.cycle - 1
                    self.counts.gaps.append((self._kept[-1].ipoc + self.cycle, found.ipoc - self.cycle))
            self._kept.append(found)
            self._received = time.monotonic()
            self._came.notify_all()


def cycle_of(data: bytes) -> Cycle:
    """Read one datagram.

    Raises
    ------
    StreamError
        It is no document of that kind.
    """
    splitter = Splitter()
    found = splitter.feed(data)
    if len(found) != 1 or found[0][0] != "Rob" or not splitter.between:
        raise StreamError("expected one Rob document")
    texts = found[0][1]
    ipoc = texts.get("Rob/IPOC", "")
    if not re.fullmatch(r"[0-9]{1,18}", ipoc):  # it goes beyond 2³¹
        raise StreamError(f"IPOC: expected a time, found {ipoc[:40]!r}")
    delay = values_of((Element("Rob/Delay/@D", "INT"),), texts)["Rob/Delay/@D"] if "Rob/Delay/@D" in texts else 0

    def six(tag: str) -> Array:
        if f"Rob/{tag}/@A1" not in texts:
            return _NAN
        return np.array(list(values_of(_axes(tag), texts).values()))

    if "Rob/AIPos/@A1" not in texts:
        raise StreamError("AIPos: expected it in every document, found none")
    return Cycle(
        int(ipoc),
        np.radians(six("AIPos")),
        np.radians(six("ASPos")),
        six("MACur"),
        six(GEAR),
        int(delay),
    )


def _axes(tag: str) -> tuple[Element, ...]:
    return tuple(Element(f"Rob/{tag}/@A{k}", "REAL") for k in range(1, AXES + 1))


def connect(address: LinkAddress) -> RsiLink:
    """Listen; the setting is ``cycle`` (4 or 12, ms).

    Raises
    ------
    LinkLostError
        Nothing comes.
    """
    chosen = address.chosen(cycle=CYCLES)
    link = RsiLink(address.host, address.port, int(chosen.get("cycle", "4")))
    end = time.monotonic() + FIRST_DATAGRAM_TIMEOUT
    while time.monotonic() < end:
        with contextlib.suppress(LinkLostError):
            link.status()
            return link
        time.sleep(0.02)
    link.close()
    raise LinkLostError(f"rsi: no datagram came to {address.host}:{address.port} within {FIRST_DATAGRAM_TIMEOUT:g} s")
