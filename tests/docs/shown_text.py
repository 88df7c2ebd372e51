"""What a page shows, held against what a command prints: the same words, and numbers that differ by little."""

from __future__ import annotations

import re

__all__ = ["unlike"]

NUMBER = re.compile(r"(?<![\w.])[-−+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]*\w@)")
# Another machine's BLAS ends a fit a little elsewhere: of a number, this share may differ, or one of its last digit.
NUMBERS_DIFFER = 0.02


def unlike(shown: str, output: str) -> str | None:
    """Say which piece of what a page shows (pieces end at an ellipsis) a command's output does not have, or None."""
    told = " ".join(output.replace("−", "-").split())
    for piece in re.split(r"(?:,|;)?\s*…", shown.replace("−", "-")):
        words = " ".join(piece.split())
        if not words:
            continue
        numbers = [m.group() for m in NUMBER.finditer(words)]
        pattern = r"([-+]?[\d.]+(?:e[-+]?\d+)?)".join(re.escape(part) for part in NUMBER.split(words))
        found = [m.groups() for m in re.finditer(f"(?={pattern})", told)]  # also where they overlap
        if not found:
            return f"not printed: {words}"
        if not any(all(map(near, numbers, groups)) for groups in found):
            return f"shown: {words}\nprinted: {found}"
    return None


def near(shown: str, is_now: str) -> bool:
    """Whether a number of a page is what it is now, nearly."""
    a, b = float(shown), float(is_now.rstrip("."))
    digit = 10.0 ** -len(shown.partition("e")[0].partition(".")[2]) if "e" not in shown else 0.0
    return abs(a - b) <= max(NUMBERS_DIFFER * abs(b), 1.001 * digit)
