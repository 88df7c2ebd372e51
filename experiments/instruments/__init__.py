"""Instruments that measure where a target is: over a socket, or through the files that their own program writes."""

from experiments.instruments.connect import connect_instrument, instrument_of
from experiments.instruments.protocol import (
    Instrument,
    InstrumentError,
    InstrumentSilentError,
    LineOfSightError,
    NotStillError,
    Sample,
)

__all__ = [
    "Instrument",
    "InstrumentError",
    "InstrumentSilentError",
    "LineOfSightError",
    "NotStillError",
    "Sample",
    "connect_instrument",
    "instrument_of",
]
