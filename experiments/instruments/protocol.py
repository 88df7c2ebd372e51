"""The interface of an instrument, as a run uses it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

__all__ = ["Instrument", "InstrumentError", "InstrumentSilentError", "LineOfSightError", "NotStillError", "Sample"]

Array = npt.NDArray[np.float64]


class InstrumentError(ValueError):
    """The instrument did not measure."""


class LineOfSightError(InstrumentError):
    """The target is not seen."""


class InstrumentSilentError(InstrumentError):
    """Nothing came from the instrument in time, or the connection broke."""


class NotStillError(InstrumentError):
    """The target kept moving."""


@dataclass(frozen=True, eq=False)
class Sample:
    """Median of some readings of one target.

    Attributes
    ----------
    point_m
        ``(3,)`` m, instrument's frame; NaN where it has no such axis. A distance stands in the first.
    std_m
        ``(3,)`` m: scatter of one reading, 1.4826 times the median absolute deviation; NaN where one reading was given.
    count
        Of the readings.
    time_s
        On the instrument's clock.
    """

    point_m: Array
    std_m: Array
    count: int
    time_s: float


class Instrument(Protocol):
    """What measures points or distances."""

    targets: tuple[str, ...]

    def measure(self, target: str, count: int, patience: float) -> Sample:
        """Wait until the target is still, and measure it.

        Parameters
        ----------
        target
            One of ``targets``.
        count
            How many readings are wanted.
        patience
            s that all of it may take.

        Raises
        ------
        LineOfSightError
            It was not seen, tried again too.
        InstrumentSilentError
            Nothing came in time.
        InstrumentError
            Something else came than a measurement.
        """

    def temperatures(self) -> Mapping[str, float]:
        """By name of the sensor, °C; empty where it has none."""

    def close(self) -> None:
        """Hang up."""
