"""KUKAVARPROXY: reads variables of the controller by name, and writes the override.

Framing, big-endian: ``u16 id, u16 length, u8 mode (0 read, 1 write), u16 name length, name [, u16 value length,
value]``; the answer has the value in the name's place and ends in 00 01 01, or in 00 00 00 where there is no such
variable.
"""

from __future__ import annotations

import asyncio
import re
import struct
from collections.abc import Callable

from experiments.virtual_controller.arm import AXES
from experiments.virtual_controller.codes import Mode
from experiments.virtual_controller.programs import Controller, milliseconds

__all__ = ["VarProxy"]

CLIENTS = 16
LONGEST_BODY = 512  # bytes of a request's body
PATIENCE = 10.0  # s for a request that has begun, or an answer that is not read
GOOD, BAD = b"\x00\x01\x01", b"\x00\x00\x00"
INDEXED = re.compile(r"(\$[A-Z_]+)\[([1-6])\]")


class VarProxy:
    """Answers KUKAVARPROXY clients.

    Parameters
    ----------
    controller
        Whose variables are read.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._clients: dict[asyncio.StreamWriter, float] = {}
        self.refused = 0
        self._variables: dict[str, Callable[[], str]] = {
            "$AXIS_ACT_MEAS": self._axes,
            "$AXIS_ACT": self._axes,
            "$OV_PRO": lambda: f"{controller.override:.0f}",
            "$MODE_OP": lambda: {Mode.AUT: "#AUT", Mode.EXT: "#EX"}.get(controller.mode, f"#{controller.mode.name}"),
            "$PERI_RDY": lambda: _truth(controller.brakes),
            "$ALARM_STOP": lambda: _truth(not controller.estop),
            "$BRAKE_SIG": lambda: "63" if controller.brakes else "0",
            "$ROB_STOPPED": lambda: _truth(controller.standing()),
            "$ROBNAME[]": lambda: f'"{controller.arm.robot.name[:24]}"',
            "$TIMER[1]": lambda: str(milliseconds(controller.clock.now())),
        }
        self._arrays: dict[str, str] = {
            "$TORQUE_AXIS_ACT": "Torque",
            "$CURR_ACT": "Current",
            "$MOT_TEMP": "Temperature",
        }

    async def client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection until it ends, or sends what is no request."""
        loop = asyncio.get_running_loop()
        if len(self._clients) >= CLIENTS:
            silent = min(self._clients, key=lambda one: self._clients[one])
            self._clients.pop(silent)
            silent.transport.abort()
        self._clients[writer] = loop.time()
        try:
            while first := await reader.read(1):
                head = first + await asyncio.wait_for(reader.readexactly(3), PATIENCE)
                number, length = struct.unpack(">HH", head)
                if not 3 <= length <= LONGEST_BODY:
                    self.refused += 1
                    break
                body = await asyncio.wait_for(reader.readexactly(length), PATIENCE)
                self._clients[writer] = loop.time()
                writer.write(self.reply(number, body))
                await asyncio.wait_for(writer.drain(), PATIENCE)
        except (OSError, TimeoutError, asyncio.IncompleteReadError):
            self.refused += 1
        except asyncio.CancelledError:
            pass  # the controller ends; streams would print a cancelled client's traceback
        finally:
            self._clients.pop(writer, None)
            writer.close()

    def reply(self, number: int, body: bytes) -> bytes:
        """Return the answer to a request's body."""
        mode = body[0]
        value = self._read(body[1:]) if mode == 0 else self._write(body[1:]) if mode == 1 else None
        if value is None:
            self.refused += 1
        text = (value or "").encode("ascii", "replace")
        end = BAD if value is None else GOOD
        return struct.pack(">HHBH", number, 3 + len(text) + len(end), mode, len(text)) + text + end

    def _read(self, rest: bytes) -> str | None:
        name, left = _text(rest)
        if name is None or left:
            return None
        name = name.upper()
        if name in self._variables:
            return self._variables[name]()
        indexed = INDEXED.fullmatch(name)
        if indexed and indexed[1] in self._arrays:
            state = self._controller.state()
            value = state[f"Robot/{self._arrays[indexed[1]]}/@A{indexed[2]}"]
            return f"{value:.0f}" if indexed[1] == "$MOT_TEMP" else f"{value:.9g}"
        return None

    def _write(self, rest: bytes) -> str | None:
        """Only the override may be written, from 1 to 100; it holds for programs accepted later."""
        name, left = _text(rest)
        value, left = _text(left)
        if name is None or value is None or left or name.upper() != "$OV_PRO":
            return None
        if not re.fullmatch(r"[0-9]{1,3}", value) or not 1 <= int(value) <= 100:
            return None
        self._controller.override = float(value)
        return value

    def _axes(self) -> str:
        state = self._controller.state()
        axes = [f"A{k} {state[f'Robot/Axis/@A{k}']:.6f}" for k in range(1, AXES + 1)]
        return f"{{E6AXIS: {', '.join(axes + [f'E{k} 0.0' for k in range(1, 7)])}}}"


def _text(data: bytes) -> tuple[str | None, bytes]:
    """A text with its length before it, and what follows."""
    if len(data) < 2:
        return None, b""
    length = int.from_bytes(data[:2], "big")
    if len(data) < 2 + length:
        return None, b""
    return data[2 : 2 + length].decode("ascii", "replace"), data[2 + length :]


def _truth(value: bool) -> str:
    return "TRUE" if value else "FALSE"
