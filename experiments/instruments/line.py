"""An instrument on a socket: a line out, a JSON line back, as ``clampid virtual-robot --tracker`` speaks.

=====================  ================================================================================================
``measure N TARGET``   ``{"target": …, "time_s": …, "points_m": [[x, y, z], …]}``, or ``distances_m: [d, …]`` of an
                       instrument that measures one length; ``{"error": "line of sight lost"}`` where it sees nothing
``targets``            ``{"targets_m": {name: …, …}}``: their names
``temperatures``       ``{"motor_C": […], "link_C": […], "ambient_C": …}``; an ``error`` where it has no sensors
=====================  ================================================================================================
"""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from experiments.instruments.protocol import (
    Array,
    InstrumentError,
    InstrumentSilentError,
    LineOfSightError,
    NotStillError,
    Sample,
)
from experiments.instruments.still import MIN_READINGS, moved_by, summary

__all__ = ["LineInstrument"]

HELLO_TIMEOUT = 5.0  # s, for answers without a measurement
AGAIN = 3  # times that a target is looked for without a line of sight
PAUSE_BETWEEN_TRIALS = 0.5  # s between them
LONGEST_ANSWER = 4_000_000  # bytes in one answer: 5000 points take 200 000
SHOWN_OF_AN_ANSWER = 80  # characters of a wrong answer in a message
FARTHEST_POINT = 1e3  # m: no instrument for robots reads more
HOTTEST = 1e3  # °C
LATEST = 1e12  # s: of any clock


class LineInstrument:
    """An instrument that answers lines.

    Parameters
    ----------
    host, port
        Where it listens.

    Raises
    ------
    InstrumentError
        Nobody listens there, or what listens is no instrument.
    """

    def __init__(self, host: str, port: int) -> None:
        self._where = (host, port)
        self._socket: socket.socket | None = None
        self._rest = b""
        named = self._ask("targets", HELLO_TIMEOUT).get("targets_m")
        if not isinstance(named, Mapping) or not named:
            self.close()
            raise InstrumentError(f"{self}: expected targets_m with the names of targets, found {_short(named)}")
        self.targets = tuple(str(name) for name in named)

    def __str__(self) -> str:
        return f"instrument at {self._where[0]}:{self._where[1]}"

    def measure(self, target: str, count: int, patience: float) -> Sample:
        """Read until the target is still; this takes at least `MIN_READINGS` readings."""
        if target not in self.targets:
            raise InstrumentError(f"{self}: expected one of {', '.join(self.targets)}, found {target!r}")
        end, wanted, unseen, moved = time.monotonic() + patience, max(count, MIN_READINGS), 0, 0.0
        while (left := end - time.monotonic()) > 0:
            try:
                found = self._ask(f"measure {wanted} {target}", left)
            except LineOfSightError:
                unseen += 1
                if unseen == AGAIN or time.monotonic() + PAUSE_BETWEEN_TRIALS > end:
                    raise
                time.sleep(PAUSE_BETWEEN_TRIALS)
                continue
            except InstrumentSilentError:
                if moved:
                    break
                raise
            readings = self._readings(found, target, wanted)
            moved = moved_by(readings)
            if not moved:
                return _sample(readings, self._time(found))
        if moved:
            raise NotStillError(f"{self}: {target} still moved by {moved * 1e6:.0f} µm after {patience:g} s")
        raise InstrumentSilentError(f"{self}: no answer within {patience:g} s")

    def temperatures(self) -> Mapping[str, float]:
        """Sensors ``motor1`` …, ``link1`` … and ``ambient``, as far as it has them."""
        found = self._ask("temperatures", HELLO_TIMEOUT)
        named: dict[str, float] = {}
        for place in ("motor", "link"):
            values = found.get(f"{place}_C", [])
            for k, value in enumerate(values if isinstance(values, list) else [values], 1):
                named[f"{place}{k}"] = _number(value, f"{self}: {place}_C", HOTTEST)
        if "ambient_C" in found:
            named["ambient"] = _number(found["ambient_C"], f"{self}: ambient_C", HOTTEST)
        return named

    def close(self) -> None:
        """Hang up."""
        if self._socket is not None:
            with suppress(OSError):
                self._socket.close()
            self._socket = None

    def _readings(self, found: Mapping[str, Any], target: str, count: int) -> Array:
        """Readings ``(N, 3)``, or ``(N, 1)`` of an instrument that measures a length."""
        if found.get("target", target) != target:
            self.close()
            raise InstrumentError(f"{self}: expected readings of {target}, found {_short(found['target'])}")
        key, width = ("distances_m", 1) if "distances_m" in found else ("points_m", 3)
        try:
            readings = np.array(found.get(key), dtype=np.float64)
        except (TypeError, ValueError):
            readings = np.zeros(0)
        if width == 1 and readings.ndim == 1:
            readings = readings[:, None]
        if readings.ndim != 2 or readings.shape[1] != width or not 1 <= len(readings) <= count:
            raise InstrumentError(
                f"{self}: {key}: expected 1 to {count} rows of {width} numbers, found {_short(found.get(key))}"
            )
        if not np.all(np.abs(readings) <= FARTHEST_POINT):  # NaN neither
            raise InstrumentError(f"{self}: {key}: expected m within {FARTHEST_POINT:g}, found {_short(found[key])}")
        return readings

    def _time(self, found: Mapping[str, Any]) -> float:
        return _number(found.get("time_s"), f"{self}: time_s", LATEST)

    def _ask(self, line: str, patience: float) -> dict[str, Any]:
        try:
            text = self._exchange(line, patience)
        except OSError as error:
            self.close()  # a late answer must not be taken for the next one's
            why = "nothing came" if isinstance(error, TimeoutError) else str(error)
            raise InstrumentSilentError(f"{self}: no answer to {line!r} within {patience:.3g} s: {why}") from None
        except InstrumentError:
            self.close()
            raise
        try:
            answer = json.loads(text)
        except (ValueError, RecursionError):
            answer = None
        if not isinstance(answer, dict):
            self.close()
            raise InstrumentError(f"{self}: expected a line with a JSON object, found {_short(text)}")
        if "error" in answer:  # the line is in order
            kind = LineOfSightError if "sight" in str(answer["error"]) else InstrumentError
            raise kind(f"{self}: {str(answer['error'])[:SHOWN_OF_AN_ANSWER]}")
        return answer

    def _exchange(self, line: str, patience: float) -> bytes:
        end = time.monotonic() + patience
        if self._socket is None:
            self._socket, self._rest = socket.create_connection(self._where, patience), b""
        elif self._rest:
            raise InstrumentError(f"{self}: expected one line to each question, found more: {_short(self._rest)}")
        self._socket.settimeout(patience)
        self._socket.sendall(f"{line}\n".encode("ascii"))
        parts = [self._rest]
        size = 0
        while True:
            left = end - time.monotonic()
            if left <= 0:
                raise TimeoutError
            self._socket.settimeout(left)
            data = self._socket.recv(65536)
            if not data:
                raise ConnectionError("it hung up")
            parts.append(data)
            size += len(data)
            if b"\n" in data:
                break
            if size > LONGEST_ANSWER:
                raise InstrumentError(f"{self}: expected a line of at most {LONGEST_ANSWER} bytes, found more")
        text, _, self._rest = b"".join(parts).partition(b"\n")
        return text


def _sample(readings: Array, when: float) -> Sample:
    point, std = np.full(3, np.nan), np.full(3, np.nan)
    width = readings.shape[1]
    point[:width], std[:width] = summary(readings)
    return Sample(point, std, len(readings), when)


def _number(value: Any, what: str, largest: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= largest:  # NaN neither
        raise InstrumentError(f"{what}: expected a number, found {_short(value)}")
    return float(value)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= SHOWN_OF_AN_ANSWER else text[: SHOWN_OF_AN_ANSWER - 1] + "…"
