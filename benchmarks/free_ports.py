"""Ports of this machine for peers in processes of their own."""

from __future__ import annotations

import random
import socket
from contextlib import suppress

__all__ = ["free_port"]

# Systems hand out ports above for outgoing connections (Linux from 32 768). A peer that starts later, or is killed and
# comes back, finds its port free only below: else a client that tries to reach it may have been given that very port.
LOWEST_PORT, HIGHEST_PORT = 20_000, 32_000


def free_port() -> int:
    """A free TCP port of the loopback that no outgoing connection is given."""
    while True:
        port = random.SystemRandom().randint(LOWEST_PORT, HIGHEST_PORT)
        with socket.socket() as tried, suppress(OSError):
            tried.bind(("127.0.0.1", port))
            return port
