"""The virtual controller's tracker over TCP, a line out and a JSON line in; median and scatter of N points."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from experiments.plans.errors import PlanError
from experiments.plans.motion import Array
from experiments.runs.people import host_and_port

__all__ = ["Instrument", "InstrumentError", "InstrumentSilentError", "LineOfSightError", "Sample", "connect_instrument"]

FIRST = 5.0  # s for the first answer
MAD = 1.4826  # of a normal distribution


class InstrumentError(ValueError):
    """The instrument did not measure."""


class LineOfSightError(InstrumentError):
    """The target is not seen."""


class InstrumentSilentError(InstrumentError):
    """Nothing came from the instrument."""


@dataclass(frozen=True, eq=False)
class Sample:
    """Median of ``count`` readings of one target: point and scatter of one reading ``(3,)`` m, instrument frame."""

    point_m: Array
    std_m: Array
    count: int
    time_s: float


class Instrument(Protocol):
    """What measures points."""

    targets: tuple[str, ...]

    def measure(self, target: str, count: int, patience: float) -> Sample:
        """Wait until the target is still, and measure; raises `InstrumentError`."""

    def temperatures(self) -> Mapping[str, float]:
        """By name of the sensor, °C."""

    def close(self) -> None:
        """Hang up."""


class LineTracker:
    """The tracker of ``clampid virtual-robot --tracker``."""

    def __init__(self, host: str, port: int) -> None:
        self._where = (host, port)
        self._socket: socket.socket | None = None
        self._rest = b""
        self.targets = tuple(self._ask("targets", FIRST)["targets_m"])

    def measure(self, target: str, count: int, patience: float) -> Sample:
        """Measure ``count`` points of a target."""
        found = self._ask(f"measure {count} {target}", patience)
        points = np.array(found["points_m"], dtype=np.float64)
        median = np.median(points, axis=0)
        scatter = MAD * np.median(np.abs(points - median), axis=0)
        return Sample(median, scatter, len(points), float(found["time_s"]))

    def temperatures(self) -> Mapping[str, float]:
        """Sensors of motors, links and air."""
        found = self._ask("temperatures", FIRST)
        named = {f"{place}{k}": value for place in ("motor", "link") for k, value in enumerate(found[f"{place}_C"], 1)}
        return {**named, "ambient": float(found["ambient_C"])}

    def close(self) -> None:
        """Hang up."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _ask(self, line: str, patience: float) -> dict[str, Any]:
        try:
            answer = self._exchange(line, patience)
        except (OSError, ValueError) as error:
            self.close()  # a late answer must not be taken for the next one's
            raise InstrumentSilentError(f"the instrument does not answer within {patience:g} s: {error}") from None
        if "error" in answer:
            kind = LineOfSightError if "sight" in str(answer["error"]) else InstrumentError
            raise kind(f"instrument: {answer['error']}")
        return answer

    def _exchange(self, line: str, patience: float) -> dict[str, Any]:
        end = time.monotonic() + patience
        if self._socket is None:
            self._socket, self._rest = socket.create_connection(self._where, patience), b""
        self._socket.settimeout(patience)
        self._socket.sendall(f"{line}\n".encode("ascii"))
        while b"\n" not in self._rest:
            self._socket.settimeout(max(end - time.monotonic(), 0.01))
            data = self._socket.recv(65536)
            if not data:
                raise OSError("it hung up")
            self._rest += data
        text, _, self._rest = self._rest.partition(b"\n")
        answer = json.loads(text)
        if not isinstance(answer, dict):
            raise ValueError("expected a JSON object")
        return answer


def connect_instrument(address: str) -> Instrument:
    """Connect to ``tcp://HOST:PORT``.

    Raises
    ------
    PlanError
        The address is none.
    InstrumentError
        Nobody answers.
    """
    scheme, _, rest = address.partition("://")
    if scheme != "tcp":
        raise PlanError(f"--instrument: expected tcp://HOST:PORT, found {address[:80]!r}")
    return LineTracker(*host_and_port(rest, "--instrument"))
