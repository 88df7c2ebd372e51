"""A KUKA controller with KUKAVARPROXY: ``varproxy://HOST:PORT`` reads variables; it moves nothing.

The proxy has no programs, no numbers and no acknowledgement: a motion sent by it could be executed twice, or believed
without having been executed. So this link reads only, and says so in its capabilities.
"""

from __future__ import annotations

import contextlib
import re
import socket
import time

import numpy as np
import numpy.typing as npt

from experiments.links.address import LinkAddress
from experiments.links.connection import Backoff
from experiments.links.protocol import (
    UNKNOWN_UNIT,
    CannotError,
    Capabilities,
    LinkLostError,
    Recording,
    Signal,
    Status,
)
from experiments.links.read_only import StatusReader
from experiments.links.schema import AXES
from experiments.links.turning import Turning
from experiments.links.varproxy_wire import Answers, Question, question_bytes

__all__ = ["VarProxyLink", "axes_of", "connect"]

Array = npt.NDArray[np.float64]

FIRST_STATUS_TIMEOUT = 3.0  # s within which the first status has to come
SILENCE = 1.0  # s that one answer may take
PERIOD = 0.1  # s between two statuses
SLOW = 20  # statuses between two readings of temperatures
ABSOLUTE_ZERO = -273.15  # degC
MODES = {"#T1": "T1", "#T2": "T2", "#AUT": "AUT", "#EX": "EXT"}
READS_ONLY = "the variable proxy reads only: it cannot say whether a motion was taken up, and could not be trusted"
_AXIS = re.compile(r"\bA([1-6])\s+([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)")


class VarProxyLink(StatusReader):
    """One robot, read variable by variable.

    Parameters
    ----------
    host, port
        Of the proxy.
    torque, current
        Units of $TORQUE_AXIS_ACT and of $CURR_ACT, where known.
    """

    why, silence = READS_ONLY, SILENCE

    def __init__(self, host: str, port: int, torque: str = UNKNOWN_UNIT, current: str = UNKNOWN_UNIT) -> None:
        clock = "this computer, at reading"
        self.capabilities = Capabilities(
            scheme="varproxy",
            signals=(
                Signal("joint", "rad", "joint", "measured", clock, PERIOD),
                Signal("torque", torque, "motor", "measured", clock, PERIOD),
                Signal("current", current, "motor", "measured", clock, PERIOD),
                Signal("temperature", "degC", "motor", "measured", clock, SLOW * PERIOD),
            ),
            cannot=(
                f"Move, stop or release: {READS_ONLY}.",
                "Record: the controller keeps no samples for it.",
                "Values at one instant: those of a status are read one after another.",
            ),
        )
        self._where, self._answers, self._number = (host, port), Answers(), 0
        self._socket: socket.socket | None = None
        self._turning = Turning()
        self._temperature: Array | None = None
        self._begin("varproxy")

    def recording(self, start: int, most: int = 1000, patience: float = 5.0) -> Recording:
        """Not possible; see `Link`."""
        raise CannotError("recording: the variable proxy keeps no samples")

    def _run(self) -> None:
        backoff, count = Backoff(), 0
        while not self._closing.is_set():
            try:
                if self._socket is None:
                    self._socket, self._answers = socket.create_connection(self._where, SILENCE), Answers()
                    self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                begun = time.monotonic()
                self._last = self._turning.seen(self._read_status(count % SLOW == 0))
                self.trouble, count = "", count + 1
                self._first.set()
                backoff.reset()
                self._closing.wait(max(PERIOD - (time.monotonic() - begun), 0.0))
            except (OSError, ValueError) as error:
                self.trouble = f"{self._where[0]}:{self._where[1]}: {getattr(error, 'strerror', None) or error}"
                self._hang_up()
                self._closing.wait(backoff.seconds())
        self._hang_up()

    def _hang_up(self) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.close()
        self._socket = None

    def _read(self, name: str) -> str | None:
        """The value of a variable as text; None: there is none.

        Raises
        ------
        OSError, ValueError
            No answer, or another one's.
        """
        if self._socket is None:
            raise OSError("not connected")
        self._number = self._number % 65535 + 1
        self._socket.sendall(question_bytes(Question(self._number, name)))
        end = time.monotonic() + SILENCE
        while True:
            self._socket.settimeout(max(end - time.monotonic(), 0.001))
            data = self._socket.recv(4096)
            if not data:
                raise OSError("the proxy closed the connection")
            for answer in self._answers.feed(data):
                if answer.number != self._number:
                    raise ValueError(f"expected the answer to question {self._number}, found that to {answer.number}")
                return answer.value

    def _read_status(self, slow: bool) -> Status:
        joints = self._read("$AXIS_ACT_MEAS")
        if joints is None:
            raise ValueError("$AXIS_ACT_MEAS: expected a value, found none")
        received = time.monotonic()
        if slow:
            kelvin = self._read_six("$MOT_TEMP")
            self._temperature = None if kelvin is None else kelvin + ABSOLUTE_ZERO
        brakes = self._read("$BRAKE_SIG")
        return Status(
            joints=np.radians(axes_of(joints)),
            mode=MODES.get((self._read("$MODE_OP") or "").strip().upper()),
            drives=_flag(self._read("$PERI_RDY")),
            brakes_open=None if brakes is None else brakes.strip() not in ("0", "'B0'", "'B000000'"),
            estop=None if (alarm := _flag(self._read("$ALARM_STOP"))) is None else not alarm,
            torque=self._read_six("$TORQUE_AXIS_ACT"),
            current=self._read_six("$CURR_ACT"),
            temperature=self._temperature,
            received=received,
        )

    def _read_six(self, name: str) -> Array | None:
        """Six elements of an array, or None where one is missing."""
        out = []
        for k in range(1, AXES + 1):
            text = self._read(f"{name}[{k}]")
            if text is None:
                return None
            out.append(_number(text, f"{name}[{k}]"))
        return np.array(out)


def axes_of(text: str) -> Array:
    """Six angles of a KRL aggregate such as ``{E6AXIS: A1 0.0, A2 -90.0, …}``, deg.

    Raises
    ------
    ValueError
        It has others.
    """
    found = dict(_AXIS.findall(text[:1000]))
    if len(found) != AXES:
        raise ValueError(f"expected A1 to A6, found {text[:60]!r}")
    return np.array([_number(found[str(k)], f"A{k}") for k in range(1, AXES + 1)])


def _number(text: str, name: str) -> float:
    try:
        value = float(text) if len(text) < 40 else np.nan
    except ValueError:
        value = np.nan
    if not abs(value) < 1e6:
        raise ValueError(f"{name}: expected a number, found {text[:40]!r}")
    return value


def _flag(text: str | None) -> bool | None:
    return None if text is None else {"TRUE": True, "FALSE": False}.get(text.strip().upper())


def connect(address: LinkAddress) -> VarProxyLink:
    """Connect; settings are ``torque`` (Nm or %) and ``current`` (A or %).

    Raises
    ------
    LinkLostError
        The proxy does not answer.
    """
    chosen = address.chosen(torque=("Nm", "%"), current=("A", "%"))
    units = chosen.get("torque", UNKNOWN_UNIT), chosen.get("current", UNKNOWN_UNIT)
    link = VarProxyLink(address.host, address.port, *units)
    try:
        link.wait_first(FIRST_STATUS_TIMEOUT)
    except LinkLostError:
        link.close()
        raise
    return link
