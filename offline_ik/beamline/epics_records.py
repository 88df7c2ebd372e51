"""EPICS motor records gamma, delta and radius over one robot, served by caproto; a client of ``clampid serve``.

Made for clients of motor records (EPICS tools, ophyd, ophyd-async). Four things that they rely on:

* control limits are published, in the records' limits and in the channels' metadata;
* a refusal toggles DMOV as a motion does, so that who waits for its fall and rise does not wait for ever; VAL goes back
  to what was accepted, and ``refusal`` says why;
* put-completion comes when the motion has ended; where it did not arrive, or was refused, the put fails;
* one lock spans the axes, and what is put within a moment is one motion (:mod:`offline_ik.beamline.combining`).
"""

from __future__ import annotations

import argparse
import asyncio
import math
import os
import socket
from collections.abc import Sequence
from typing import Any, ClassVar

from clampid.wrong_call import CallError
from offline_ik.beamline.combining import AXES, Combined
from offline_ik.beamline.line_client import Server
from offline_ik.beamline.side import LENGTHS, add_arguments, follow_parent, lock_of, server_of
from offline_ik.exchange.address import parse_address

__all__ = ["main"]

LOOK = 0.1  # s between two readings of where the robot is
ANGLE_RANGES = {"gamma": (-180.0, 180.0), "delta": (-90.0, 90.0)}  # deg
LARGEST_RADIUS = 10.0  # m, of the radius: as far as the line protocol hears of
LONGEST_MESSAGE = 65536  # bytes
TEXT = 400  # characters


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the records: ``python -m offline_ik.beamline.epics_records PREFIX``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("prefix")
    parser.add_argument("--listen", default="127.0.0.1:5064")
    parser.add_argument("--radius-unit", choices=LENGTHS, default="mm")
    add_arguments(parser)
    given = parser.parse_args(arguments)
    host, port = parse_address(given.listen)
    # caproto reads the port, and whom to tell that it is there, from the environment only.
    os.environ |= {"EPICS_CA_SERVER_PORT": str(port), "EPICS_CAS_AUTO_BEACON_ADDR_LIST": "NO"}
    os.environ["EPICS_CAS_BEACON_ADDR_LIST"] = "255.255.255.255"
    follow_parent()
    server, locked = server_of(given, "epics")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as nobody:
        if host.startswith("127."):  # nobody is to be told; caproto insists on telling somebody
            nobody.bind((host, 0))
            beacons = {"EPICS_CAS_BEACON_ADDR_LIST": host, "EPICS_CAS_BEACON_PORT": str(nobody.getsockname()[1])}
            os.environ |= beacons
        asyncio.run(_serve(server, locked, given.prefix, host, given.radius_unit))


async def _serve(server: Server, locked: str, prefix: str, host: str, unit: str) -> None:
    from caproto.asyncio.server import start_server

    _bound_messages()
    records = _records()(prefix, Robot(server, locked, unit))

    async def ready(_: Any) -> None:
        at = f"{host}:{os.environ['EPICS_CA_SERVER_PORT']}"
        print(f"epics on {at} {' '.join(prefix + axis for axis in AXES)}", flush=True)

    await start_server(records.pvdb, interfaces=[host], startup_hook=ready)


def _bound_messages() -> None:
    """Close connections that announce a message larger than any record takes: caproto would store up to 4 GB."""
    from caproto import RemoteProtocolError, VirtualCircuit

    recv = VirtualCircuit.recv

    def bounded(self: Any, *buffers: Any) -> Any:
        commands, needed = recv(self, *buffers)
        if needed > LONGEST_MESSAGE:
            raise RemoteProtocolError(f"expected a message of at most {LONGEST_MESSAGE} bytes, found {needed} more")
        return commands, needed

    VirtualCircuit.recv = bounded


class Robot:
    """The robot in the records' units."""

    def __init__(self, server: Server, locked: str, unit: str) -> None:
        self.server, self.locked, self.unit = server, locked, unit
        self.combined = Combined(server)
        self.refusal = ""
        metres = LENGTHS[unit]
        self.scale = {"gamma": math.degrees(1.0), "delta": math.degrees(1.0), "radius": 1.0 / metres}
        self.units = {"gamma": "deg", "delta": "deg", "radius": unit}
        self.limits = {**ANGLE_RANGES, "radius": (0.0, LARGEST_RADIUS / metres)}

    async def move(self, axis: str, value: float) -> None:
        """One axis there.

        Raises
        ------
        CallError
            Why not.
        """
        if self.locked:
            raise CallError(self.locked)
        low, high = self.limits[axis]
        if not low <= value <= high:
            raise CallError(f"{axis}: expected {low:g} to {high:g} {self.units[axis]}, found {value:g}")
        await self.combined.move(**{axis: value / self.scale[axis]})

    async def unlock(self, token: str) -> None:
        """Let records that a network reaches move the robot."""
        self.server, self.locked = await asyncio.to_thread(lock_of, self.server, self.locked, token)
        await self.combined.close()
        self.combined = Combined(self.server)


def _records() -> Any:
    """The classes: caproto is imported on request only."""
    from caproto import AlarmSeverity, AlarmStatus, CAStatus, ChannelType, SkipWrite
    from caproto.server import PVGroup, SubGroup, pvproperty
    from caproto.server.server import PvpropertyChar, PvpropertyDouble

    class Completing:
        """A put that is refused is completed as failed; told as an error, some clients would go on waiting."""

        async def write_from_dbr(self, *args: Any, **kwargs: Any) -> Any:
            try:
                return await super().write_from_dbr(*args, **kwargs)  # type: ignore[misc]
            except CallError:
                return CAStatus.ECA_PUTFAIL.value.code_with_severity

    class Text(Completing, PvpropertyChar):
        """Characters."""

    class Coordinate(Completing, PvpropertyDouble):
        """A channel whose limits are checked by the putter: caproto would refuse before DMOV could toggle."""

        async def verify_value(self, data: Any) -> Any:
            if self.putter is not None:
                return await self.putter(self, data)
            return data

    class Axis(PVGroup):
        """A motor record."""

        type_map: ClassVar[dict[Any, Any]] = {**PVGroup.type_map, float: Coordinate}
        motor = pvproperty(value=0.0, name="", record="motor", dtype=float)

        def __init__(self, *args: Any, axis: str, robot: Robot, **kwargs: Any) -> None:
            super().__init__(*args, **kwargs)
            self.axis, self.robot, self.puts = axis, robot, 0

        async def prepare(self) -> None:
            """Publish units, precision and limits."""
            (low, high), unit = self.robot.limits[self.axis], self.robot.units[self.axis]
            fields, precision = self.motor.field_inst, 4 if unit in ("deg", "mm") else 7 if unit == "m" else 1
            metadata = {
                "units": unit, "precision": precision, "lower_ctrl_limit": low, "upper_ctrl_limit": high,
                "lower_disp_limit": low, "upper_disp_limit": high,
            }  # fmt: skip
            await self.motor.write_metadata(**metadata)
            for field in (fields.user_readback_value, fields.dial_readback_value):
                await field.write_metadata(**metadata)
            for field, value in (
                (fields.user_low_limit, low), (fields.user_high_limit, high), (fields.dial_low_limit, low),
                (fields.dial_high_limit, high), (fields.engineering_units, unit), (fields.velocity, 1.0),
                (fields.max_velocity, 1.0), (fields.seconds_to_velocity, 1.0), (fields.display_precision, precision),
                (fields.done_moving_to_value, 1), (fields.motor_is_moving, 0),
            ):  # fmt: skip
                await field.write(value, verify_value=False)

        async def show(self, reply: dict[str, Any]) -> None:
            """Where it is."""
            fields, scale, name = self.motor.field_inst, self.robot.scale[self.axis], AXES[self.axis]
            for field in (fields.user_readback_value, fields.dial_readback_value):
                await field.write(reply["at"][name] * scale, verify_value=False)
            await fields.motor_is_moving.write(int(reply["moving"]), verify_value=False)
            accepted = reply["setpoint"][name] * scale
            if not self.puts and self.motor.value != accepted:
                await self.motor.write(accepted, verify_value=False, update_fields=False)

        @motor.putter
        async def motor(self, instance: Any, value: Any) -> Any:
            """Move there; ends when the motion has."""
            wanted = float(value[0] if hasattr(value, "__len__") else value)
            done = self.motor.field_inst.done_moving_to_value
            self.puts += 1
            await done.write(0, verify_value=False)
            if math.isfinite(wanted):
                await instance.write(wanted, verify_value=False, update_fields=False)
            reason = ""
            try:
                await self.robot.move(self.axis, wanted)
            except CallError as error:
                reason = str(error)
            self.puts -= 1
            self.robot.refusal = reason
            await self.parent.refusal.write(reason[:TEXT], verify_value=False)
            await self.parent.look()
            low, high = self.robot.limits[self.axis]
            await self.motor.field_inst.limit_violation.write(int(not low <= wanted <= high), verify_value=False)
            if not self.puts:
                await done.write(1, verify_value=False)
            if reason:
                raise CallError(reason)
            await instance.alarm.write(status=AlarmStatus.NO_ALARM, severity=AlarmSeverity.NO_ALARM)
            raise SkipWrite

        @motor.fields.stop.putter
        async def motor(fields: Any, instance: Any, value: Any) -> Any:  # noqa: N805 - caproto hands the fields over
            """Stop the robot."""
            if value:
                await fields.parent.group.robot.combined.stop()
            return 0

    class Records(PVGroup):
        """The records and what is told beside them."""

        type_map: ClassVar[dict[Any, Any]] = {**PVGroup.type_map, ChannelType.CHAR: Text}
        gamma = SubGroup(Axis, prefix="gamma", axis="gamma", robot=None)
        delta = SubGroup(Axis, prefix="delta", axis="delta", robot=None)
        radius = SubGroup(Axis, prefix="radius", axis="radius", robot=None)
        refusal = pvproperty(value="", dtype=ChannelType.CHAR, max_length=TEXT, read_only=True)
        holder = pvproperty(value="", dtype=ChannelType.CHAR, max_length=TEXT, read_only=True)
        trouble = pvproperty(value="", dtype=ChannelType.CHAR, max_length=TEXT, read_only=True)
        measured = pvproperty(value=[0.0, 0.0, 0.0], dtype=float, read_only=True)
        uncertainty = pvproperty(value=[0.0, 0.0, 0.0], dtype=float, read_only=True)
        stop = pvproperty(value=0, dtype=int)
        unlock = pvproperty(value="", dtype=ChannelType.CHAR, max_length=TEXT)

        def __init__(self, prefix: str, robot: Robot) -> None:
            super().__init__(prefix=prefix)
            self.robot = robot
            for axis in self.axes:
                axis.robot = robot

        @property
        def axes(self) -> tuple[Any, Any, Any]:
            return self.gamma, self.delta, self.radius

        async def look(self) -> None:
            """Show where the robot is; what cannot be known is an alarm."""
            try:
                reply = await self.robot.combined.robot()
            except CallError as error:
                await self.alarm(AlarmSeverity.INVALID_ALARM, AlarmStatus.COMM)
                await self.trouble.write(str(error)[:TEXT], verify_value=False)
                return
            if self.trouble.value:
                await self.alarm(AlarmSeverity.NO_ALARM, AlarmStatus.NO_ALARM)
                await self.trouble.write("", verify_value=False)
            for axis in self.axes:
                await axis.show(reply)
            at, scale = reply["at"], self.robot.scale
            await self.measured.write([at[name] * scale[axis] for axis, name in AXES.items()], verify_value=False)
            stds = {"gamma": at["gamma_std_rad"], "delta": at["delta_std_rad"], "radius": at["r_std_m"]}
            found = [math.nan if value is None else value * scale[axis] for axis, value in stds.items()]
            await self.uncertainty.write(found, verify_value=False)
            who = reply["holder"]
            said = "" if who is None else f"{who['name'] or 'a client without a name'} ({who['address']})"
            if said != self.holder.value:
                await self.holder.write(said[:TEXT], verify_value=False)

        async def alarm(self, severity: Any, status: Any) -> None:
            """Whether the readbacks are valid."""
            for axis in self.axes:
                await axis.motor.field_inst.user_readback_value.alarm.write(severity=severity, status=status)

        @measured.startup
        async def measured(self, instance: Any, async_lib: Any) -> None:
            """Look again and again."""
            for axis in self.axes:
                await axis.prepare()
            while True:
                await self.look()
                await asyncio.sleep(LOOK)

        @stop.putter
        async def stop(self, instance: Any, value: Any) -> Any:
            """Stop the robot, whatever is written."""
            await self.robot.combined.stop()
            return 0

        @unlock.putter
        async def unlock(self, instance: Any, value: Any) -> Any:
            """Take the token; it is not kept."""
            await self.robot.unlock(value if isinstance(value, str) else bytes(value).decode())
            return ""

    return Records


if __name__ == "__main__":
    main()
