"""The kind of a file, by its first bytes: a verb replaces a file of another kind only with ``--force``."""

from __future__ import annotations

import re
from typing import Literal

__all__ = ["LOOKED_AT", "OF_FORMAT", "Kind", "kind_of"]

LOOKED_AT = 65536  # bytes of a file by which its kind is recognised

Kind = Literal[
    "a model", "a diagnosis", "JSON", "HTML", "a picture (SVG)", "a URDF", "a plan", "a DH table",
    "a table of joint errors", "a printed table", "KUKA machine data", "a geometry for pyFAI", "Python",
]  # fmt: skip
"""Kinds that verbs write; other files are of kinds that :func:`kind_of` names in the same way."""
OF_FORMAT = {
    "clampid-model": "a model",
    "clampid-diagnosis": "a diagnosis",
    "clampid-plan": "a plan",
    "clampid-campaign": "the header of a campaign",
    "clampid-mapping": "a mapping",
    "clampid-touched": "a file of touches",
    "clampid-trusted-effects": "the list of trusted effects",
}
_MARKUP = {"svg": "a picture (SVG)", "robot": "a URDF", "html": "HTML"}
_TABLES = {"row": "a DH table", "joint": "a table of joint errors"}
_TEXTS = (
    (r"\| link \|", "a printed table"),
    (r"; clampid: .* KUKA machine data", "KUKA machine data"),
    (r"(?:#.*\n)*poni_version:", "a geometry for pyFAI"),
    (r"(?:#.*\n|\s)*\[{1,2}[\w.\"-]+\]{1,2}\s*$|(?:#.*\n|\s)*[\w.\"-]+ *= *\S", "TOML"),
)


def kind_of(start: bytes) -> str | None:
    """Of what kind a file is that begins so; None: it is empty.

    Parameters
    ----------
    start
        The first `LOOKED_AT` bytes, or all of them.
    """
    raw = start.removeprefix(b"\xef\xbb\xbf").strip()
    if not raw:
        return None
    if raw.startswith(b"PAR1"):
        return "a Parquet table"
    if b"\0" in raw or _broken(raw, cut=len(start) >= LOOKED_AT):
        return "binary data"
    return _kind_of_text(raw.decode("utf-8", "replace"))


def _kind_of_text(text: str) -> str:
    if text.startswith("<"):
        first = re.search(
            r"<([a-z][a-z0-9:]*)", re.sub(r"<!--.*?-->|<\?.*?\?>|<!.*?>", "", text, flags=re.DOTALL), re.I
        )
        return _MARKUP.get(first[1].lower() if first else "", "XML")
    if text.startswith("{") or re.match(r"\[\s*([\[{\]\d-]|$)|\[\s*\"[^\"]*\"\s*,", text):
        return _by_format(re.search(r'"format" *: *"(clampid-[a-z-]+)/', text), "JSON")
    named = re.search(r'^format *= *"(clampid-[a-z-]+)/', text, re.MULTILINE)
    if named is not None:
        return _by_format(named, "TOML")
    if re.search(r"^(?:from|import) \w|^EFFECTS? *=", text, re.MULTILINE):
        return "Python"
    return next((kind for pattern, kind in _TEXTS if re.match(pattern, text, re.MULTILINE)), _table(text))


def _by_format(found: re.Match[str] | None, otherwise: str) -> str:
    if found is None:
        return otherwise
    return OF_FORMAT.get(found[1], f"a file of the format {found[1]}")


def _table(text: str) -> str:
    """The kind of a table, by its first column."""
    header = text.partition("\n")[0].strip()
    cells = re.split(r"[,;\t]", header)
    if len(cells) < 2 or not all(re.fullmatch(r"[\w\"'/%°()\[\]. -]{1,80}", cell) for cell in cells):
        return "plain text"
    first = cells[0].strip("\"' ")
    return _TABLES.get(first, f"a table whose first column is {first!r}")


def _broken(text: bytes, cut: bool) -> bool:
    """Whether it is no UTF-8; where it was cut, the last character may be."""
    try:
        text.decode("utf-8")
    except UnicodeDecodeError as error:
        return not (cut and error.start >= len(text) - 4)
    return False
