"""HOST:PORT of a server's line, and whether others than this machine can reach it."""

from __future__ import annotations

import contextlib
import ipaddress

from kinematics.host_port import host_and_port
from offline_ik.errors import DetectorError

__all__ = ["is_loopback", "parse_address"]


def parse_address(text: str) -> tuple[str, int]:
    """Read HOST:PORT.

    Raises
    ------
    DetectorError
        It is none.
    """
    try:
        return host_and_port(text, least=0)
    except ValueError as error:
        raise DetectorError(str(error)) from None


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach an address."""
    if host == "localhost":
        return True
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return False
