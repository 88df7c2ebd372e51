"""Config files of EthernetKRL: the XML that says which documents go over a channel.

Source: KUKA.EthernetKRL 2.2 as gathered in public code and manuals; the order of the parts is that of its examples.
"""

from __future__ import annotations

from experiments.links.schema import ALIVE_FLAGS, CHANNELS, DATA_FLAGS, PORT, Channel

__all__ = ["CONNECT_MS", "REOPEN_MS", "config_text"]

CONNECT_MS = 60000  # ms for which a channel that EKI_Open has opened listens for a client
REOPEN_MS = 50000  # ms after which the programs open it again: nobody may come for days


def config_text(channel: Channel, port: int = PORT, address: str = "") -> str:
    """Write the config file of a channel.

    Parameters
    ----------
    channel
        One of the schema's.
    port
        Of the motion channel.
    address
        The controller's own address on that network; without it, all of its addresses listen.

    Returns
    -------
    str
        The file ``<name>.xml``; ASCII.
    """
    k = CHANNELS.index(channel)
    internal = [
        f"<ENVIRONMENT>{channel.environment}</ENVIRONMENT>",
        f'<BUFFERING Mode="FIFO" Limit="{channel.limit}"/>',
        f'<BUFFSIZE Limit="{channel.buffer}"/>',
        f'<TIMEOUT Connect="{CONNECT_MS}"/>',
        f'<ALIVE Set_Flag="{ALIVE_FLAGS[k]}"/>',
        *([f"<IP>{address}</IP>"] if address else []),
        f"<PORT>{port + channel.offset}</PORT>",
        "<PROTOCOL>TCP</PROTOCOL>",
        '<MESSAGES Logging="warning" Display="disabled"/>',
    ]
    received = [f'<ELEMENT Tag="{e.tag}" Type="{e.type}"/>' for e in channel.receive]
    received.append(f'<ELEMENT Tag="{channel.receive[0].root}" Set_Flag="{DATA_FLAGS[k]}"/>')
    sent = [f'<ELEMENT Tag="{e.tag}"/>' for e in channel.send]
    lines = [
        "<ETHERNETKRL>",
        "  <CONFIGURATION>",
        "    <EXTERNAL>",
        "      <TYPE>Client</TYPE>",
        "    </EXTERNAL>",
        "    <INTERNAL>",
        *(f"      {line}" for line in internal),
        "    </INTERNAL>",
        "  </CONFIGURATION>",
        "  <RECEIVE>",
        "    <XML>",
        *(f"      {line}" for line in received),
        "    </XML>",
        "  </RECEIVE>",
        "  <SEND>",
        "    <XML>",
        *(f"      {line}" for line in sent),
        "    </XML>",
        "  </SEND>",
        "</ETHERNETKRL>",
    ]
    return "\n".join(lines) + "\n"
