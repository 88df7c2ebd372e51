"""Verbs of installed packages. One that cannot be loaded says so when it is called, and all others work."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from typing import Any, NamedTuple

import typer

from clampid.verbs.plain_help import PlainCommand

__all__ = ["GROUP", "BrokenPackageError", "Installed", "installed_verbs"]

GROUP = "clampid.verbs"
OWN = frozenset({"clampid", "offline_ik"})
"""Packages that come with clampid: their verbs are not tried before they are used."""


class BrokenPackageError(RuntimeError):
    """A verb of an installed package that cannot be used; the message names the package and its error."""


class Installed(NamedTuple):
    """A verb.

    Attributes
    ----------
    verb
        A function for typer, or a group of them.
    broken
        It only says why it cannot be loaded, whatever its arguments.
    """

    verb: Any
    broken: bool = False


def installed_verbs() -> dict[str, Installed]:
    """Every verb by name; of two that have one name, clampid's own counts."""
    points = sorted(entry_points(group=GROUP), key=_is_own)
    return {point.name: _loaded(point) for point in {point.name: point for point in points}.values()}


def _is_own(point: EntryPoint) -> bool:
    return point.value.partition(":")[0].partition(".")[0] in OWN


def _loaded(point: EntryPoint) -> Installed:
    if _is_own(point):
        return Installed(point.load())
    try:
        verb = point.load()
        alone = typer.Typer()
        if isinstance(verb, typer.Typer):
            alone.add_typer(verb, name=point.name)
        else:
            alone.command(point.name, cls=PlainCommand)(verb)
        typer.main.get_command(alone)  # what typer cannot read is found here
    except (Exception, SystemExit) as error:  # another's code may raise anything
        return Installed(_broken(point, f"{type(error).__name__}: {error}"), broken=True)
    return Installed(verb)


def _broken(point: EntryPoint, why: str) -> Callable[[], None]:
    package = point.value if point.dist is None else f"{point.dist.name} {point.dist.version}"

    def broken() -> None:
        raise BrokenPackageError(f"the verb {point.name} of the package {package} cannot be loaded: {why}")

    broken.__doc__ = f"Cannot be loaded (package {package})."
    return broken
