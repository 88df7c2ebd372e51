"""Options of ``clampid serve`` for Tango, EPICS and other protocols besides the line protocol."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from offline_ik.beamline.processes import Side, check_installed
from offline_ik.beamline.side import LENGTHS
from offline_ik.errors import DetectorError
from offline_ik.exchange.address import is_loopback, parse_address

if TYPE_CHECKING:
    from clampid.verbs.output import Output

__all__ = ["Given", "listens_on", "sides_of"]

_WORD = r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}"
RESERVED = ("dserver", "sys")  # of Tango's own devices


class Given(NamedTuple):
    """Options as they were given."""

    tango: str | None
    tango_listen: str
    epics: str | None
    epics_listen: str
    radius_unit: str
    token_file: Path | None


def sides_of(given: Given, linked: bool, out: Output) -> list[Side]:
    """The sides to start.

    Raises
    ------
    DetectorError
        An option is none, its package is not installed, or there is no robot to show.
    """
    if given.radius_unit not in LENGTHS:
        raise DetectorError(f"--radius-unit: expected {', '.join(LENGTHS)}, found {given.radius_unit!r}")
    found = []
    if given.tango is not None:
        if not re.fullmatch(f"{_WORD}/{_WORD}", given.tango):
            expected = "SERVER/INSTANCE, each a letter or digit and up to 63 more, _, . or -"
            raise DetectorError(f"--tango: expected {expected}, found {given.tango[:80]!r}")
        if given.tango.partition("/")[0].lower() in RESERVED:
            raise DetectorError(f"--tango: expected another name than Tango's own, found {given.tango!r}")
        found.append(_side("tango", "tango_device", given.tango, given.tango_listen, given, linked, out))
    if given.epics is not None:
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_:{}-]{0,39}", given.epics):  # what follows a dot is a field
            expected = "a prefix as BL:DET:, a letter or digit and up to 39 more, _, :, -, { or }"
            raise DetectorError(f"--epics: expected {expected}, found {given.epics[:80]!r}")
        found.append(_side("epics", "epics_records", given.epics, given.epics_listen, given, linked, out))
    return found


def listens_on(option: str, text: str) -> tuple[str, int]:
    """HOST:PORT of an option of a side; its port is not 0, so that clients can know it in advance.

    Raises
    ------
    DetectorError
        It is none.
    """
    try:
        host, port = parse_address(text)
    except DetectorError as error:
        raise DetectorError(f"{option}: {error}") from None
    if not port:
        raise DetectorError(f"{option}: expected a port from 1 to 65535, found {text!r}")
    return host, port


PACKAGES = {"tango": "tango", "epics": "caproto"}


def _side(name: str, module: str, own: str, listen: str, given: Given, linked: bool, out: Output) -> Side:
    check_installed(PACKAGES[name], f"--{name}", name)
    if not linked:
        raise DetectorError(f"--{name}: expected a robot to move, found no --link")
    host, port = listens_on(f"--{name}-listen", listen)
    at = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    arguments = [own, "--listen", at, "--radius-unit", given.radius_unit]
    lock = "no" if is_loopback(host) else "closed" if given.token_file is None else "token"
    if lock == "no" and given.token_file is not None:
        arguments += ["--token-file", str(given.token_file)]
    if lock != "no":
        moves = "nothing moves: there is no --token-file" if lock == "closed" else "it moves once it is given the token"
        out.warn(f"anyone who reaches {host} can ask the {name} side; {moves}")
    return Side(name, f"offline_ik.beamline.{module}", (*arguments, "--lock", lock))
