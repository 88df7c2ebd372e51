"""Reads a config file of EthernetKRL: the elements that a channel receives, stores and sends.

Written from the descriptions of EthernetKRL 2.2, not from the code that generates such files here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal
from xml.etree import ElementTree
from xml.parsers import expat

from experiments.virtual_controller.errors import ControllerError

__all__ = ["Config", "Tag", "read_config"]

Type = Literal["INT", "REAL", "BOOL", "STRING"]
TYPES: tuple[Type, ...] = ("INT", "REAL", "BOOL", "STRING")
FIFO_LIMIT, MAX_FIFO = 16, 512  # values of one element: EthernetKRL's default and its most
BUFFER_LIMIT, MAX_BUFFER = 16384, 65534  # bytes: likewise


@dataclass(frozen=True)
class Tag:
    """One element that a channel takes, such as ``Move/Axis/@A1``."""

    path: str
    type: Type


@dataclass(frozen=True)
class Config:
    """A channel as its config file describes it.

    Attributes
    ----------
    name
        For messages.
    environment
        ``Program``, ``Submit`` or ``System``: which interpreter owns the channel.
    port
        Where it listens on a real controller, if the file says so.
    limit
        Values that are stored of each element; one more closes the connection.
    buffer
        Bytes of a document that is not whole yet; more close the connection.
    alive
        The ``$FLAG`` that is set while a client is connected, if any.
    receive
        Elements with a value, in order.
    flags
        Flags that are set when an element has come whole: path and ``$FLAG``.
    send
        Paths of a document that is sent, in order.
    """

    name: str
    environment: str
    port: int | None
    limit: int
    buffer: int
    alive: int | None
    receive: tuple[Tag, ...]
    flags: tuple[tuple[str, int], ...]
    send: tuple[str, ...]

    @property
    def root(self) -> str:
        """Root element of the documents that are taken."""
        return self.receive[0].path.partition("/")[0]


def read_config(text: str, name: str) -> Config:
    """Read a config file.

    Parameters
    ----------
    text
        Its content.
    name
        For messages.

    Raises
    ------
    ControllerError
        It is no config of a TCP channel on which the controller is the server.
    """
    root = _parsed(text, name)
    if root.tag != "ETHERNETKRL":
        raise ControllerError(f"{name}: expected the root element ETHERNETKRL, found {root.tag}")
    if (kind := root.findtext("CONFIGURATION/EXTERNAL/TYPE", "Server").strip()) != "Client":
        raise ControllerError(f"{name}: expected EXTERNAL/TYPE Client (the controller serves), found {kind}")
    inner = root.find("CONFIGURATION/INTERNAL")
    if inner is None:
        raise ControllerError(f"{name}: expected CONFIGURATION/INTERNAL, found none")
    if (protocol := inner.findtext("PROTOCOL", "TCP").strip()) != "TCP":
        raise ControllerError(f"{name}: expected PROTOCOL TCP, found {protocol}")
    buffering = inner.find("BUFFERING")
    if buffering is not None and buffering.get("Mode", "FIFO") != "FIFO":
        raise ControllerError(f"{name}: expected BUFFERING Mode FIFO, found {buffering.get('Mode')}")
    port = inner.findtext("PORT")
    receive, flags = _received(root, name)
    sent = tuple(_attribute(e, "Tag", name) for e in root.findall("SEND/XML/ELEMENT"))
    if not sent:
        raise ControllerError(f"{name}: expected SEND/XML with at least one ELEMENT, found none")
    return Config(
        name=name,
        environment=inner.findtext("ENVIRONMENT", "Program").strip(),
        port=None if port is None else _number(port, f"{name}: PORT", 1, 65535),
        limit=_limit(buffering, name, "BUFFERING Limit", FIFO_LIMIT, MAX_FIFO),
        buffer=_limit(inner.find("BUFFSIZE"), name, "BUFFSIZE Limit", BUFFER_LIMIT, MAX_BUFFER),
        alive=_flag(inner.find("ALIVE"), name),
        receive=receive,
        flags=flags,
        send=sent,
    )


def _parsed(text: str, name: str) -> ElementTree.Element:
    """The file's elements; documents with a DTD are refused, because entities may be declared there."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ControllerError(f"{name}: expected a config file without DOCTYPE, found one")
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, expat.ExpatError) as error:
        raise ControllerError(f"{name}: no XML: {error}") from None


def _received(root: ElementTree.Element, name: str) -> tuple[tuple[Tag, ...], tuple[tuple[str, int], ...]]:
    tags: list[Tag] = []
    flags: list[tuple[str, int]] = []
    for element in root.findall("RECEIVE/XML/ELEMENT"):
        path, kind, flag = _attribute(element, "Tag", name), element.get("Type"), element.get("Set_Flag")
        if flag is not None:
            flags.append((path, _number(flag, f"{name}: {path}: Set_Flag", 1, 1024)))
        if kind is None and flag is not None:
            continue
        if kind not in TYPES:
            raise ControllerError(f"{name}: {path}: expected Type {', '.join(TYPES)}, found {kind}")
        tags.append(Tag(path, kind))
    if not tags:
        raise ControllerError(f"{name}: expected RECEIVE/XML with at least one ELEMENT that has a Type, found none")
    roots = {tag.path.partition("/")[0] for tag in tags}
    if len(roots) > 1:
        raise ControllerError(f"{name}: expected one root element in RECEIVE, found {', '.join(sorted(roots))}")
    if len({tag.path for tag in tags}) < len(tags):
        raise ControllerError(f"{name}: expected every Tag of RECEIVE once, found one twice")
    return tuple(tags), tuple(flags)


def _attribute(element: ElementTree.Element, key: str, name: str) -> str:
    value = element.get(key)
    if not value:
        raise ControllerError(f"{name}: expected an attribute {key} in every ELEMENT, found none")
    return value


def _limit(element: ElementTree.Element | None, name: str, what: str, default: int, most: int) -> int:
    value = None if element is None else element.get("Limit")
    return default if value is None else _number(value, f"{name}: {what}", 1, most)


def _flag(element: ElementTree.Element | None, name: str) -> int | None:
    value = None if element is None else element.get("Set_Flag")
    return None if value is None else _number(value, f"{name}: ALIVE Set_Flag", 1, 1024)


def _number(text: str, what: str, least: int, most: int) -> int:
    try:
        value = int(text.strip())
    except ValueError:
        value = least - 1
    if not least <= value <= most:
        raise ControllerError(f"{what}: expected an integer from {least} to {most}, found {text.strip()!r}")
    return value
