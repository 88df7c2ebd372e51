"""HOST:PORT of a server's line, and whether others than this machine can reach it."""

from __future__ import annotations

import contextlib
import ipaddress

from offline_ik.errors import DetectorError

__all__ = ["parse_address"]


def parse_address(text: str) -> tuple[str, int]:
    """Read HOST:PORT.

    Raises
    ------
    DetectorError
        It is none.
    """
    host, colon, port = text.rpartition(":")
    if not colon or not host or not port.isdigit() or int(port) > 65535:
        raise DetectorError(f"expected HOST:PORT, found {text!r}")
    return host.strip("[]"), int(port)


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach an address."""
    if host == "localhost":
        return True
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return False
