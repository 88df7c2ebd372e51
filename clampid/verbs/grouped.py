"""Options that go together as one value: a verb takes a dataclass, its command line has an option for each field."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable
from typing import Any, get_type_hints

__all__ = ["grouped"]


def grouped(verb: Callable[..., None]) -> Callable[..., None]:
    """Spell out every parameter of a verb whose type is a dataclass of options, and put it together again when called.

    The fields must have defaults; their annotations say what the options are, as a verb's own parameters would.
    """
    hints = get_type_hints(verb, include_extras=True)
    groups: dict[str, Any] = {name: hint for name, hint in hints.items() if dataclasses.is_dataclass(hint)}
    spelt: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(verb).parameters.items():
        if name not in groups:
            spelt.append(parameter.replace(annotation=hints[name]))
            continue
        fields = get_type_hints(groups[name], include_extras=True)
        spelt += [
            inspect.Parameter(f.name, parameter.kind, default=f.default, annotation=fields[f.name])
            for f in dataclasses.fields(groups[name])
        ]
    # Python wants what has no default first, typer does not mind the order.
    spelt.sort(key=lambda p: p.default is not inspect.Parameter.empty)

    @functools.wraps(verb)
    def call(**given: Any) -> None:
        for name, group in groups.items():
            own = [f.name for f in dataclasses.fields(group)]
            given[name] = group(**{key: given.pop(key) for key in own})
        verb(**given)

    call.__signature__ = inspect.Signature(spelt)  # type: ignore[attr-defined]
    call.__annotations__ = {p.name: p.annotation for p in spelt}
    return call
