"""The config file of a read-only RSI stream: the controller sends each cycle and expects no answer.

Source: KUKA.RobotSensorInterface as public configs have it. Gear torques come from GEARTORQUE objects of the signal
flow, whose outputs are wired to the inputs 1 to 6 of the ETHERNET object.
"""

from __future__ import annotations

from experiments.links.schema import AXES

__all__ = ["GEAR", "RSI_PORT", "rsi_config_text"]

RSI_PORT = 49152
GEAR = "Gear"


def rsi_config_text(address: str, port: int = RSI_PORT) -> str:
    """Write the file ``ClampidRSI.xml``.

    Parameters
    ----------
    address, port
        Where this suite listens, as the controller reaches it.
    """
    internal = [("DEF_AIPos", "DOUBLE"), ("DEF_ASPos", "DOUBLE"), ("DEF_MACur", "DOUBLE"), ("DEF_Delay", "LONG")]
    elements = [f'<ELEMENT TAG="{tag}" TYPE="{kind}" INDX="INTERNAL"/>' for tag, kind in internal]
    elements += [f'<ELEMENT TAG="{GEAR}.A{k}" TYPE="DOUBLE" INDX="{k}"/>' for k in range(1, AXES + 1)]
    lines = [
        "<ROOT>",
        "  <CONFIG>",
        f"    <IP_NUMBER>{address}</IP_NUMBER>",
        f"    <PORT>{port}</PORT>",
        "    <SENTYPE>Clampid</SENTYPE>",
        "    <ONLYSEND>TRUE</ONLYSEND>",
        "  </CONFIG>",
        "  <SEND>",
        "    <ELEMENTS>",
        *(f"      {element}" for element in elements),
        "    </ELEMENTS>",
        "  </SEND>",
        "  <RECEIVE>",
        "    <ELEMENTS>",
        "    </ELEMENTS>",
        "  </RECEIVE>",
        "</ROOT>",
    ]
    return "\n".join(lines) + "\n"
