"""Addresses of links: ``scheme://HOST:PORT?key=value``; the scheme chooses the module that speaks to the robot."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from typing import cast
from urllib.parse import parse_qsl

from experiments.links.protocol import Link, LinkError
from kinematics.host_port import is_host

__all__ = ["DEFAULT_SCHEME", "GROUP", "LinkAddress", "installed", "open_link", "parse_address"]

GROUP = "clampid.robot_links"
"""Entry points: the name is the scheme, the object is called with a `LinkAddress` and gives a `Link`."""
DEFAULT_SCHEME = "eki"
LONGEST_ADDRESS = 500  # characters
_ADDRESS = re.compile(r"(?:([a-z][a-z0-9+.-]*)://)?(?:\[([0-9a-fA-F:.]+)\]|([^\s:/?\[\]]+)):([0-9]{1,5})(?:/?\?(.*))?")


@dataclass(frozen=True)
class LinkAddress:
    """Where a robot is, how it is spoken to, and what its settings are.

    Attributes
    ----------
    scheme
        Of the way of speaking.
    host, port
        Where.
    settings
        Of the query; a link refuses keys that it does not know.
    """

    scheme: str
    host: str
    port: int
    settings: Mapping[str, str] = field(default_factory=dict)

    def chosen(self, **choices: tuple[str, ...] | None) -> dict[str, str]:
        """Settings by key, each one of its choices; None: any text.

        Raises
        ------
        LinkError
            A key or a value that is none of them.
        """
        for key, value in self.settings.items():
            if key not in choices:
                known = ", ".join(choices) or "none"
                raise LinkError(f"{self.scheme} link: expected settings {known}; found {key}")
            options = choices[key]
            if options is not None and value not in options:
                raise LinkError(f"{self.scheme} link: {key}: expected {' or '.join(options)}, found {value!r}")
        return dict(self.settings)

    def seconds(self, key: str, default: float, most: float) -> float:
        """A time of the settings, s."""
        text = self.settings.get(key)
        if text is None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = -1.0
        if not 0.0 < value <= most:
            raise LinkError(
                f"{self.scheme} link: {key}: expected seconds, above 0 and at most {most:g}, found {text!r}"
            )
        return value


def parse_address(text: str) -> LinkAddress:
    """Read an address; without a scheme it is an EthernetKRL link.

    Raises
    ------
    LinkError
        It is none.
    """
    found = _ADDRESS.fullmatch(text) if len(text) <= LONGEST_ADDRESS else None
    if found is None or not 0 < int(found[4]) < 65536 or not is_host(found[2] or found[3]):
        raise LinkError(f"link: expected SCHEME://HOST:PORT, found {text[:80]!r}")
    if (found[2] or found[3]) == "HOST":  # a command copied as a screen prints it
        raise LinkError(f"link: expected the robot's own address for HOST, found {text[:80]!r}")
    pairs = parse_qsl(found[5] or "", keep_blank_values=True)
    if len(dict(pairs)) != len(pairs):
        raise LinkError(f"link: expected each setting once, found one twice in {text[:80]!r}")
    return LinkAddress(found[1] or DEFAULT_SCHEME, found[2] or found[3], int(found[4]), dict(pairs))


def installed() -> tuple[str, ...]:
    """Schemes of the links that are installed."""
    return tuple(sorted({point.name for point in entry_points(group=GROUP)}))


def open_link(text: str) -> Link:
    """Connect to a robot.

    Parameters
    ----------
    text
        Its address.

    Raises
    ------
    LinkError
        The scheme is not installed, or the robot does not answer.
    """
    address = parse_address(text)
    for point in entry_points(group=GROUP):
        if point.name == address.scheme:
            return _loaded(point)(address)
    known = ", ".join(installed()) or "none"
    raise LinkError(f"link {text[:80]}: expected one of the installed schemes ({known}), found {address.scheme}")


def _loaded(point: EntryPoint) -> Callable[[LinkAddress], Link]:
    """What makes the link; it may be another package's, which may be broken."""
    package = point.value if point.dist is None else f"{point.dist.name} {point.dist.version}"
    try:
        connect = point.load()
    except Exception as error:  # another's code may raise anything
        why = f"{type(error).__name__}: {error}"
        raise LinkError(f"link {point.name} of the package {package} cannot be loaded: {why}") from error
    if not callable(connect):
        raise LinkError(f"link {point.name} of the package {package}: expected a function, found {connect!r:.80}")
    return cast("Callable[[LinkAddress], Link]", connect)
