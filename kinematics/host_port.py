"""HOST:PORT as text; impossible host names are refused, because resolving some of them raises other errors or hangs."""

import re

__all__ = ["host_and_port", "is_host"]

_NAME = re.compile(r"[A-Za-z0-9_](?:[A-Za-z0-9_.-]{0,251}[A-Za-z0-9_])?")
_IPV6 = re.compile(r"[0-9A-Fa-f]{0,4}:[0-9A-Fa-f:.]{1,44}(?:%[A-Za-z0-9]{1,15})?")
_LABEL = 63  # characters of a host's name between two dots


def is_host(text: str) -> bool:
    """Whether a text can be a host's name or address; that of IPv6 without brackets."""
    if _IPV6.fullmatch(text):
        return True
    return bool(_NAME.fullmatch(text)) and all(0 < len(part) <= _LABEL for part in text.split("."))


def host_and_port(text: str, least: int = 1) -> tuple[str, int]:
    """
    Read HOST:PORT.

    Parameters
    ----------
    text
        A host's name or address, that of IPv6 with or without brackets, and a port.
    least
        The least port; 0 where a free one may be taken.

    Returns
    -------
    tuple of str and int
        Host without brackets, and port.

    Raises
    ------
    ValueError
        It is none.
    """
    host, _, port = text.rpartition(":")
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
    if not is_host(host) or not re.fullmatch("[0-9]{1,5}", port) or not least <= int(port) <= 65535:
        raise ValueError(f"expected HOST:PORT, found {text[:80]!r}")
    return host, int(port)
