"""The literature that docstrings, effects and reports cite by key."""

import re
from importlib import resources

__all__ = ["load_sources"]

_ENTRY = re.compile(r"^@\w+\{\s*([^,\s]+)\s*,", re.MULTILINE)
_TITLE = re.compile(r"^\s*title\s*=\s*\{(.*)\}\s*,?\s*$", re.MULTILINE | re.IGNORECASE)


def load_sources() -> dict[str, str]:
    """
    Read appendix_data/sources.bib.

    Returns
    -------
    dict of str to str
        Title by citation key, in the file's order.

    Raises
    ------
    ValueError
        If an entry has no title (on a line of its own) or a key occurs twice.
    """
    text = resources.files("appendix_data").joinpath("sources.bib").read_text(encoding="utf-8")
    starts = list(_ENTRY.finditer(text))
    titles: dict[str, str] = {}
    for here, following in zip(starts, [*starts[1:], None], strict=True):
        key = here.group(1)
        title = _TITLE.search(text, here.end(), following.start() if following else len(text))
        if title is None or key in titles:
            found = "two" if title else "no title"
            raise ValueError(f"sources.bib: expected one entry {key} with a title, found {found}")
        titles[key] = title.group(1).replace("{", "").replace("}", "")
    return titles
