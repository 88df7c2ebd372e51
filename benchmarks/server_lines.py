"""Lines for the command server: a good one, rubbish, and what is meant to do harm."""

from __future__ import annotations

import numpy as np

from offline_ik.exchange.requests import WORDS
from offline_ik.server.server import LINE_BYTES

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


VALUES = (
    "nan", "inf", "-1", "1e308", "1e-320", "0x10", "1_0", "yes", "no", "free", "all", "," * 40, "1," * 60 + "1",
    "9" * 300, "../../etc/passwd", "%s%n",
    "<svg/onload=x>", "'; drop", "\u0000", "-0", "1e5000", "S63T63", "true", "None",
)  # fmt: skip


def hostile(rng: np.random.Generator) -> bytes:
    """What is meant to do harm: known words and keys with values that nobody means. No `stop`, nor a good `move`."""
    words = [word for word in WORDS if word not in ("stop", "quit", "hello", "sample")]
    word = words[rng.integers(len(words))]
    match rng.integers(6):
        case 0:
            return rubbish(rng)
        case 1:  # every key, one of them twice
            keys = (*WORDS[word], "id", "robot", "id")
        case 2:
            keys = tuple(rng.choice([k for keys in WORDS.values() for k in keys], rng.integers(0, 6)))
        case _:
            keys = tuple(rng.permutation(WORDS[word])[: rng.integers(1, 8)]) if WORDS[word] else ("id",)
    given = [f"{key}={VALUES[rng.integers(len(VALUES))]}" for key in keys if key != "timeout"]
    if word == "move":
        given.append("r=nan")
    if word == "moved":
        given.append("timeout=0")
    return " ".join([word, *given]).encode("ascii", "replace").replace(b"\n", b" ")
