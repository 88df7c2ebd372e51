r"""
Escapes names from outside for files and screens: one function for each language.

A robot called ``"kuka\n$MAMES[1]=99"`` must not become a line of a controller's file, an escape sequence must not
reach a terminal, and a cell of a table must not become a formula. Descriptions refuse such names as well
(`has_controls`); these functions hold for what comes another way.
"""

import re

__all__ = ["for_csv", "for_krl", "for_markdown", "for_terminal", "has_controls", "is_formula"]

# C1 controls, line and paragraph separators, what turns the direction of text, and what nobody sees: two names that
# look alike would be two. (Joiners, U+200C and U+200D, are part of words in some scripts.)
_UNSEEN = (
    "\x7f-\x9f\xad\u061c\u180e\u2028\u2029\u200b\u200e\u200f\u202a-\u202e\u2060-\u2064\u2066-\u206f\ufeff\ufff9-\ufffb"
    "\U000e0000-\U000e007f"
)
_CONTROLS = re.compile(f"[\x00-\x1f{_UNSEEN}]")
_CONTROLS_BUT_LINES = re.compile(f"[\x00-\x08\x0b-\x1f{_UNSEEN}]")


def has_controls(text: str) -> bool:
    """Whether a text has characters that are no signs: line ends, escapes, what turns the direction of text."""
    return _CONTROLS.search(text) is not None or any("\ud800" <= sign <= "\udfff" for sign in text)


def is_formula(text: str) -> bool:
    """Whether a spreadsheet that opens a table with such a name would work something out, or start a program.

    ``+X`` and ``-X``, sides of a block, are none: it takes a call, another sheet or another program.
    """
    begun = text.lstrip()
    return begun[:1] in tuple("=@＝＠") or (begun[:1] in tuple("+-＋－") and any(sign in begun for sign in "(|!"))


def for_terminal(text: str, lines: bool = True) -> str:
    r"""
    What a terminal prints as it stands, with controls spelt (``\x1b``).

    Parameters
    ----------
    text
        Anything.
    lines
        Whether line ends and tabs are meant.
    """
    return (_CONTROLS_BUT_LINES if lines else _CONTROLS).sub(lambda found: _spelt(found[0]), text)


def for_krl(text: str) -> str:
    """One line of a remark in a controller's file: ASCII, printable, of at most 200 characters."""
    return "".join(sign if " " <= sign <= "~" else "?" for sign in _CONTROLS.sub(" ", text))[:200]


def for_csv(text: str) -> str:
    """A cell of text that no spreadsheet takes for a formula, and that is one line."""
    line = _CONTROLS.sub(" ", text)
    return f"'{line}" if line.lstrip()[:1] in tuple("=+-@＝＋－＠") else line


def for_markdown(text: str) -> str:
    """A piece of one line, with what Markdown would take for markup escaped."""
    return re.sub(r"([\\`*_\[\]<>|#])", r"\\\1", _CONTROLS.sub(" ", text))


def _spelt(sign: str) -> str:
    return sign.encode("unicode_escape").decode("ascii")
