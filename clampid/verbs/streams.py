"""Standard streams in any encoding: words lose their signs and not themselves, results for programs are UTF-8."""

from __future__ import annotations

import codecs
import io
import sys

__all__ = ["any_encoding", "write_result"]

PLAIN = {
    "µ": "u", "μ": "u", "±": "+-", "°": "deg", "·": "*", "×": "x", "²": "^2", "³": "^3", "−": "-", "–": "-", "—": "-",
    "…": "...", "→": "->", "≥": ">=", "≤": "<=", "σ": "sigma", "γ": "gamma", "δ": "delta", "τ": "tau", "θ": "theta",
    "’": "'", "“": '"', "”": '"',
}  # fmt: skip
"""What is printed for signs that a stream's encoding does not have."""


def any_encoding() -> None:
    """Let nothing that is printed fail for want of a sign in the encoding of stdout or stderr."""
    codecs.register_error("clampid", _plain)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="clampid")


def write_result(text: str) -> None:
    """Print a result for programs: UTF-8 whatever the terminal's encoding, as in a file."""
    buffer = getattr(sys.stdout, "buffer", None)
    sys.stdout.flush()
    if buffer is None:  # replaced, in a notebook or by a test
        sys.stdout.write(text)
    else:
        buffer.write(text.encode("utf-8", "backslashreplace"))
    sys.stdout.flush()


def _plain(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    signs = error.object[error.start : error.end]
    return "".join(PLAIN.get(sign, "?") for sign in signs), error.end
