"""A Universal Robots controller over RTDE, version 2, reading only: ``rtde://HOST:30004``.

Joints, currents and temperatures come at the requested rate. Motions are not implemented. They would need a program on
the controller, and no such controller was available for tests.

Source: Universal Robots, Real-Time Data Exchange (RTDE) Guide.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Iterator

import numpy as np

from experiments.links.address import LinkAddress
from experiments.links.connection import Backoff
from experiments.links.protocol import CannotError, Capabilities, LinkLostError, Recording, Signal, Status
from experiments.links.read_only import StatusReader
from experiments.links.turning import Turning

__all__ = ["RtdeLink", "connect"]

FIRST_STATUS_TIMEOUT = 3.0  # s within which the first status has to come
SILENCE = 1.0  # s without anything, after which the connection counts as dead
RATES = ("10", "125", "500")  # Hz; controllers of the CB series give 125 at most
VERSION = 2
LISTENS_ONLY = "the RTDE link reads only"
RUNNING_MODE = 7  # robot_mode: powered, brakes released
EMERGENCY = (6, 7)  # safety_mode: of the system, of the robot
HEAD = struct.Struct(">HB")
FIELDS = {
    "timestamp": ("DOUBLE", "d"),
    "actual_q": ("VECTOR6D", "6d"),
    "actual_current": ("VECTOR6D", "6d"),
    "joint_temperatures": ("VECTOR6D", "6d"),
    "robot_mode": ("INT32", "i"),
    "safety_mode": ("INT32", "i"),
}
DATA = struct.Struct(">B" + "".join(code for _, code in FIELDS.values()))
ANGLES = 100.0  # rad, beyond which no joint is


class RtdeLink(StatusReader):
    """One robot.

    Parameters
    ----------
    host, port
        Of the controller.
    rate
        Of the statuses, Hz.
    """

    why, silence = LISTENS_ONLY, SILENCE

    def __init__(self, host: str, port: int, rate: float = 125.0) -> None:
        clock, period = "controller, timestamp", 1.0 / rate
        self.capabilities = Capabilities(
            scheme="rtde",
            signals=(
                Signal("joint", "rad", "joint", "measured", clock, period),
                Signal("current", "A", "motor", "measured", clock, period),
                Signal("temperature", "degC", "motor", "measured", clock, period),
            ),
            cannot=(
                f"Move, stop or release: {LISTENS_ONLY}.",
                "Torques: RTDE gives targets, and measures none.",
                "Record: the controller keeps no samples.",
            ),
        )
        self._where, self._rate, self._turning = (host, port), rate, Turning()
        self._begin("rtde")

    def recording(self, start: int, most: int = 1000, patience: float = 5.0) -> Recording:
        """Not possible; see `Link`."""
        raise CannotError("recording: the controller keeps no samples for RTDE")

    def _run(self) -> None:
        backoff = Backoff()
        while not self._closing.is_set():
            try:
                with socket.create_connection(self._where, SILENCE) as found:
                    self._follow(found, backoff)
            except (OSError, ValueError) as error:
                self.trouble = f"{self._where[0]}:{self._where[1]}: {getattr(error, 'strerror', None) or error}"
                self._closing.wait(backoff.seconds())

    def _follow(self, found: socket.socket, backoff: Backoff) -> None:
        """Greet the controller, and take what it sends until it ends.

        Raises
        ------
        OSError, ValueError
            The connection ended, or what came is no RTDE.
        """
        packages = _packages(found, self._closing)
        recipe_id = _greeted(found, packages, self._rate)
        for kind, payload in packages:
            if kind != b"U":
                continue
            if len(payload) != DATA.size or payload[0] != recipe_id:
                raise ValueError(f"RTDE: expected {DATA.size} bytes of recipe {recipe_id}, found {len(payload)} others")
            status = _status_of(payload)
            last = self._last
            if last is None or last.clock != status.clock:  # a clock that stands makes it old, as silence does
                self._last = self._turning.seen(status)
            self.trouble = ""
            self._first.set()
            backoff.reset()


def _packages(found: socket.socket, closing: threading.Event) -> Iterator[tuple[bytes, bytes]]:
    """Kinds and payloads, text messages aside; a package has 64 KiB at most, by its own length."""
    buffer = b""
    while not closing.is_set():
        while len(buffer) >= HEAD.size:
            size, kind = HEAD.unpack_from(buffer)
            if size < HEAD.size:
                raise ValueError(f"RTDE: expected a package of {HEAD.size} bytes or more, found {size}")
            if len(buffer) < size:
                break
            payload, buffer = buffer[HEAD.size : size], buffer[size:]
            if kind != ord("M"):
                yield bytes([kind]), payload
        with contextlib.suppress(InterruptedError):
            data = found.recv(65536)
            if not data:
                raise OSError("the controller closed the connection")
            buffer += data
    raise OSError("closed")


def _greeted(found: socket.socket, packages: Iterator[tuple[bytes, bytes]], rate: float) -> int:
    """Agree on the version and on what is sent, and start it; the number of the recipe."""

    def asked(kind: bytes, payload: bytes = b"") -> bytes:
        found.sendall(HEAD.pack(HEAD.size + len(payload), kind[0]) + payload)
        for said, answer in packages:
            if said == kind:
                return answer
            if said != b"U":
                break
        raise ValueError(f"RTDE: expected the answer to {kind.decode()}, found another")

    if asked(b"V", struct.pack(">H", VERSION)) != b"\x01":
        raise ValueError(f"RTDE: the controller does not speak version {VERSION}")
    asked(b"v")
    answer = asked(b"O", struct.pack(">d", rate) + ",".join(FIELDS).encode())
    types, expected = answer[1:].decode("ascii", "replace").split(","), [kind for kind, _ in FIELDS.values()]
    if not answer or answer[0] == 0 or types != expected:
        raise ValueError(f"RTDE: expected values of {', '.join(expected)}, found {', '.join(types)[:200]}")
    if asked(b"S") != b"\x01":
        raise ValueError("RTDE: the controller does not start to send")
    return answer[0]


def _status_of(payload: bytes) -> Status:
    values = DATA.unpack(payload)
    numbers = np.array(values[1:20], dtype=np.float64)
    if not np.isfinite(numbers).all() or np.abs(numbers[1:7]).max() > ANGLES:
        raise ValueError("RTDE: expected angles and other finite numbers, found others")
    robot_mode, safety_mode = values[20:22]
    return Status(
        joints=numbers[1:7],
        drives=robot_mode == RUNNING_MODE,
        brakes_open=robot_mode == RUNNING_MODE,
        estop=safety_mode in EMERGENCY,
        clock=float(numbers[0]),
        current=numbers[7:13],
        temperature=numbers[13:19],
        received=time.monotonic(),
    )


def connect(address: LinkAddress) -> RtdeLink:
    """Connect; the setting is ``rate`` (10, 125 or 500 Hz; 125).

    Raises
    ------
    LinkLostError
        The controller does not answer.
    """
    link = RtdeLink(address.host, address.port, float(address.chosen(rate=RATES).get("rate", "125")))
    try:
        link.wait_first(FIRST_STATUS_TIMEOUT)
    except LinkLostError:
        link.close()
        raise
    return link
