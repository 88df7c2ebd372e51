"""Help in the words of the command line: ``CAMPAIGN…``, not ``{CAMPAIGN…}... <list[Path]>``."""

from __future__ import annotations

from typing import Any

from typer.core import TyperCommand

__all__ = ["PlainCommand"]

PLACEHOLDERS = {int: "N", float: "NUMBER", str: "NAME"}


class PlainCommand(TyperCommand):
    """A verb whose arguments are shown by their names alone, and numbers as ``N``."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.help = (self.help or "").replace("``", "")
        params: list[Any] = list(self.params)
        for param in params:
            if param.param_type_name == "argument":
                _shown_by_name(param)
            elif param.metavar is None:
                kind: Any = getattr(getattr(param, "type_descriptor", None), "annotation", None)
                param.metavar = PLACEHOLDERS.get(kind)


def _shown_by_name(argument: Any) -> None:
    """No type beside an argument: its name and its help say what it is."""
    name = argument.metavar or argument.name.upper()
    typed = name if argument.required else f"[{name.strip('[]')}]"
    argument.display_type_rich = lambda ctx=None: None
    argument._usage_display_name = lambda: typed
