"""From an address to an instrument."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from urllib.parse import parse_qsl

from experiments.instruments.folder import FolderInstrument, reading_of
from experiments.instruments.line import LineInstrument
from experiments.instruments.protocol import Instrument, InstrumentError
from kinematics.host_port import host_and_port

__all__ = ["connect_instrument", "instrument_of"]

KINDS = "tcp://HOST:PORT or folder:DIR[?key=value&…]"


def connect_instrument(address: str) -> Instrument:
    """Connect to ``tcp://HOST:PORT`` or ``folder:DIR?columns=X,Y,Z&…`` (keys: `reading_of`).

    Raises
    ------
    InstrumentError
        The address is none, nobody answers there, or the folder does not exist.
    """
    return instrument_of(address)()


def instrument_of(address: str) -> Callable[[], Instrument]:
    """A function that connects to an address as `connect_instrument` does; nothing is opened yet.

    Raises
    ------
    InstrumentError
        The address is none.
    """
    if address.startswith("tcp://HOST:"):  # a command copied as a screen prints it
        raise InstrumentError(f"instrument: expected its own address for HOST and PORT, found {address[:80]!r}")
    if address.startswith("tcp://"):
        try:
            at = host_and_port(address.removeprefix("tcp://"))
        except ValueError:
            raise InstrumentError(f"instrument: expected {KINDS}, found {address[:80]!r}") from None
        return lambda: LineInstrument(*at)
    if address.startswith("folder:"):
        path, mark, query = address.removeprefix("folder:").partition("?")
        try:
            pairs = parse_qsl(query, strict_parsing=True, keep_blank_values=True) if mark else []
        except ValueError:
            raise InstrumentError(f"instrument: expected key=value&key=value after ?, found {query[:80]!r}") from None
        keys = [key for key, _ in pairs]
        if twice := sorted({key for key in keys if keys.count(key) > 1}):
            raise InstrumentError(f"instrument: expected each key once, found {twice[0]} twice")
        reading = reading_of(dict(pairs))
        return lambda: FolderInstrument(Path(path), reading)
    raise InstrumentError(f"instrument: expected {KINDS}, found {address[:80]!r}")
