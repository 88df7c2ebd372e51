"""Lines for the command server: a good one, and rubbish."""

from __future__ import annotations

import numpy as np

from offline_ik.server import LINE_BYTES

GOOD = b"where gamma=0.3 delta=0.2 r=0.8"


def rubbish(rng: np.random.Generator) -> bytes:
    """What is no request: random bytes, a piece of a good line, one too long, posture angles beyond any number."""
    match rng.integers(5):
        case 0:
            return bytes(rng.integers(0, 256, rng.integers(0, 300), dtype=np.uint8)).replace(b"\n", b" ")
        case 1:
            return GOOD[: rng.integers(0, len(GOOD) - 8)]
        case 2:
            return b"where " + b"x" * int(rng.integers(LINE_BYTES, 3 * LINE_BYTES))
        case 3:
            return GOOD + b" near=" + b",".join([b"1e999"] * 6)
        case _:
            return b"\x00" * 10
