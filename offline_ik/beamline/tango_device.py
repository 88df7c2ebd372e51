"""A Tango device, without a database, that moves the detector: ``position`` is [gamma, delta, radius].

It is a client of ``clampid serve``, in a process of its own, and is made for clients that read ``position``, change one
element and write all three back, wait until ``State`` is ON, and call `Init` and `Connect` and try again for ever when
a write raises. Hence:

* a position that is refused (out of reach, beyond a limit, in the way of something) raises nothing: the state stays ON,
  nothing moves, and ``last_refusal`` says why;
* while the robot stands ``position`` is what was accepted; what is measured is in attributes of its own;
* the state is MOVING when the write of an accepted position returns.

Units are degrees, and a setting for the radius.
"""

from __future__ import annotations

import argparse
import math
import os
import socket
import sys
import threading
from collections.abc import Sequence
from typing import Any

import tango
from tango import AttrWriteType, DevState, SerialModel
from tango.server import Device, attribute, command, run

from clampid.wrong_call import CallError
from offline_ik.beamline.gate import Bounds, Gate, free_port
from offline_ik.beamline.line_client import Line, LostError, Server
from offline_ik.beamline.side import LENGTHS, add_arguments, follow_parent, lock_of, server_of
from offline_ik.exchange.address import parse_address

__all__ = ["DetectorRobot", "main"]

STATE = 2.0  # s that the server may take to say where the robot is


class DetectorRobot(Device):
    """The detector on its robot."""

    server: Server
    metres: float = 1e-3
    locked: str = ""

    def init_device(self) -> None:
        """Connect anew; moves and stops nothing."""
        super().init_device()
        self._close()
        self._lines = {name: Line(self._server()) for name in ("move", "robot", "stop")}
        self._refusal = ""

    def delete_device(self) -> None:
        """End the connections."""
        self._close()
        super().delete_device()

    def _server(self) -> Server:
        return type(self).server

    def _close(self) -> None:
        for line in getattr(self, "_lines", {}).values():
            line.close()

    def _robot(self) -> dict[str, Any]:
        return self._lines["robot"].ask("robot", timeout=STATE)

    def _coordinates(self, at: dict[str, Any]) -> list[float]:
        return [math.degrees(at["gamma_rad"]), math.degrees(at["delta_rad"]), at["r_m"] / self.metres]

    def dev_state(self) -> DevState:
        """ON where it stands, MOVING where it moves, FAULT where nobody knows."""
        try:
            return DevState.MOVING if self._robot()["moving"] else DevState.ON
        except CallError:
            return DevState.FAULT

    def dev_status(self) -> str:
        """The same in words, with the last refusal and who holds the robot."""
        try:
            found = self._robot()
        except CallError as error:
            return str(error)
        holder = found["holder"]
        said = ["The robot moves." if found["moving"] else "The robot stands."]
        if holder is not None:
            said.append(f"It is held by {holder['name'] or 'a client without a name'} ({holder['address']}).")
        refusal, ended = self._refusal or found["last_refusal"], found["ended"]
        if refusal:
            said.append(f"Refused: {refusal}")
        elif not found["moving"] and ended is not None and ended["outcome"] != "arrived":
            said.append(f"The last motion: {': '.join(filter(None, (ended['outcome'], ended['reason'])))}")
        return "\n".join(said)

    @attribute(dtype=(float,), max_dim_x=3, access=AttrWriteType.READ_WRITE, doc="[gamma, delta, radius]: accepted")
    def position(self) -> list[float]:
        """While it stands, what was accepted last; while it moves, what is measured."""
        found = self._robot()
        return self._coordinates(found["at"] if found["moving"] else found["setpoint"])

    @position.write
    def position(self, value: Sequence[float]) -> None:
        """Move there; what is refused is published, and raises nothing."""
        self._refusal = self._refused(list(map(float, value)))

    def _refused(self, value: list[float]) -> str:
        """Why nothing moves; empty: it moves."""
        if type(self).locked:
            return type(self).locked
        if len(value) != 3 or not all(map(math.isfinite, value)):
            return f"position: expected [gamma, delta, radius], three finite numbers, found {value}"
        gamma, delta, r = math.radians(value[0]), math.radians(value[1]), value[2] * self.metres
        try:
            before = self._robot()["setpoint"]
            back = self._coordinates(before)
            # What was read comes back as it was accepted, not as degrees round it.
            gamma = before["gamma_rad"] if value[0] == back[0] else gamma
            delta = before["delta_rad"] if value[1] == back[1] else delta
            r = before["r_m"] if value[2] == back[2] else r
            reply = self._lines["move"].move(gamma=gamma, delta=delta, r=r)
        except LostError as error:
            return f"{error}; whether the robot moves is not known, see State"
        except CallError as error:
            return str(error)
        if reply["moving"]:
            return ""
        return "; ".join(reply.get("reasons") or reply.get("path", {}).get("reasons") or ["not reachable"])

    @attribute(dtype=(float,), max_dim_x=3, doc="[gamma, delta, radius] as measured")
    def measured(self) -> list[float]:
        """Where the robot is."""
        return self._coordinates(self._robot()["at"])

    @attribute(dtype=(float,), max_dim_x=3, doc="standard deviations of measured, in its units")
    def uncertainty(self) -> list[float]:
        """How far off the measured position may be, by the model."""
        at = self._robot()["at"]
        outer = (math.nan if at[k] is None else math.degrees(at[k]) for k in ("gamma_std_rad", "delta_std_rad"))
        return [*outer, at["r_std_m"] / self.metres]

    @attribute(dtype=(float,), max_dim_x=6, unit="mm, deg", doc="X Y Z A B C of the flange as the controller shows it")
    def flange(self) -> list[float]:
        """What the controller's display shows."""
        return list(self._robot()["at"]["controller_flange"].values())

    @attribute(dtype=(float,), max_dim_x=32, unit="deg", doc="joint angles")
    def joints(self) -> list[float]:
        """Joint angles."""
        return [math.degrees(angle) for angle in self._robot()["at"]["q_rad"]]

    @attribute(dtype=str, doc="why the last written position was refused; empty if it was not")
    def last_refusal(self) -> str:
        """Why."""
        return self._refusal

    @attribute(dtype=str, doc="who holds the robot; empty: nobody")
    def holder(self) -> str:
        """Who."""
        found = self._robot()["holder"]
        return "" if found is None else f"{found['name'] or 'a client without a name'} ({found['address']})"

    @command
    def Stop(self) -> None:
        """Stop the robot at once, whoever moves it."""
        self._lines["stop"].ask("stop")

    @command
    def Connect(self) -> None:
        """Connect to the server, if that is not so already; moves and stops nothing."""
        self._lines["robot"].ask("robot", timeout=STATE)

    @command(dtype_in=str, doc_in="the token of --token-file")
    def Unlock(self, token: str) -> None:
        """Let a device that a network reaches move the robot, for as long as it runs."""
        kind = type(self)
        kind.server, kind.locked = lock_of(kind.server, kind.locked, token)
        self._close()
        self._lines = {name: Line(kind.server) for name in self._lines}


THREADS = str(Bounds.connections + 8)  # of the device's server: one for each connection that the gate lets through


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the device: ``python -m offline_ik.beamline.tango_device SERVER/INSTANCE``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", help="SERVER/INSTANCE")
    parser.add_argument("--listen", default="127.0.0.1:7311")
    parser.add_argument("--radius-unit", choices=LENGTHS, default="mm")
    add_arguments(parser)
    given = parser.parse_args(arguments)
    server, instance = given.name.split("/")
    device, (host, port) = f"{server}/{instance}/detector", parse_address(given.listen)
    DetectorRobot.server, DetectorRobot.locked = server_of(given, "tango")
    DetectorRobot.metres = LENGTHS[given.radius_unit]
    follow_parent()

    def ready() -> None:
        # A stop does not wait for a write that is being checked.
        tango.Util.instance().set_serial_model(SerialModel.NO_SYNC)
        print(f"tango on tango://{given.listen}/{device}#dbase=no", flush=True)

    behind = free_port()
    try:
        Gate(host, port, behind).open()
    except OSError as error:
        parser.exit(2, f"tango: cannot listen on {given.listen}: {error}\n")
    named = socket.gethostname() if host in ("0.0.0.0", "::") else f"[{host}]" if ":" in host else host
    # The server's own words go to stderr: of stdout one line is read, that it is ready.
    own = [
        "-nodb", "-dlist", device, "-ORBmaxServerThreadPoolSize", THREADS,
        "-ORBendPoint", f"giop:tcp:127.0.0.1:{behind}", "-ORBendPointPublish", f"giop:tcp:{named}:{port}",
    ]  # fmt: skip
    try:
        run((DetectorRobot,), args=[server, instance, *own], msg_stream=sys.stderr, post_init_callback=ready)
    finally:
        sys.stdout.flush()
    threading.Timer(1.0, os._exit, (0,)).start()


if __name__ == "__main__":
    main()
