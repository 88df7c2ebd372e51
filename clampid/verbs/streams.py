"""Standard streams in any encoding: signs that it lacks are spelt out; results for programs are UTF-8."""

from __future__ import annotations

import codecs
import io
import re
import sys
import unicodedata

__all__ = ["any_encoding", "spelt", "write_result"]

PLAIN = {
    "µ": "u", "μ": "u", "±": "+-", "°": "deg", "·": "*", "×": "x", "²": "^2", "³": "^3", "−": "-", "–": "-", "—": "-",
    "…": "...", "⋯": "...", "→": "->", "▶": ">", "≥": ">=", "≤": "<=", "≻": ">", "≈": "~", "≠": "!=", "√": "sqrt",
    "∫": "int", "∂": "d", "½": "1/2", "’": "'", "“": '"', "”": '"', "─": "-", "│": "|", "└": "`",
}  # fmt: skip
"""What is printed for signs that a stream's encoding does not have."""


def any_encoding() -> None:
    """Let nothing that is printed fail for want of a sign in the encoding of stdout or stderr."""
    codecs.register_error("clampid", _plain)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(encoding=None if _takes_words(stream.encoding) else "utf-8", errors="clampid")


def _takes_words(encoding: str) -> bool:
    """Whether any text can be written in an encoding; it cannot in those of host names, such as ``idna``."""
    try:
        ("µ" * 100 + "..\n").encode(encoding, "clampid")
    except (UnicodeError, LookupError):
        return False
    return True


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
    return spelt(error.object[error.start : error.end]), error.end


def spelt(signs: str) -> str:
    """Signs in ASCII: ``10⁻⁶`` as ``10^-6``, Greek letters by name, letters without their accents, ``?`` at worst."""
    return _RAISED.sub(lambda found: "^" + _ascii(found[0]), signs).translate(_TABLE)


def _ascii(signs: str) -> str:
    plain = unicodedata.normalize("NFKD", signs).replace("−", "-")
    return plain.encode("ascii", "ignore").decode()


class _Table(dict[int, str]):
    """Of `str.translate`; what is not in it is worked out once."""

    def __missing__(self, number: int) -> str:
        sign = chr(number)
        letter = re.fullmatch(r"GREEK (SMALL|CAPITAL) LETTER (?:FINAL )?(\w+)", unicodedata.name(sign, ""))
        if sign in PLAIN or number < 128:
            found = PLAIN.get(sign, sign)
        elif letter:
            word = letter[2].replace("LAMDA", "LAMBDA")
            found = word.lower() if letter[1] == "SMALL" else word.capitalize()
        else:
            found = _ascii(sign) or ("" if unicodedata.combining(sign) else "?")
        self[number] = found
        return found


_RAISED = re.compile("[¹²³⁰⁴-⁹⁺⁻]+")
_TABLE = _Table()
