"""The detector as an ophyd-async device for bluesky: one movable, and three axes that are derived from it.

``set({"gamma": …, "delta": …, "radius": …})`` is one motion. So is what a plan sets of the axes ``gamma``, ``delta``
and ``radius`` at one point (:mod:`offline_ik.beamline.combining`): a grid over gamma and delta makes as many motions
as it has points. What is refused fails its status before anything moves. Angles are degrees, the radius has a unit.

The device is a client of ``clampid serve`` over TCP, and needs no middleware::

    with init_devices():
        detector = DetectorRobot("127.0.0.1:7310", name="detector")
    RE(bp.grid_scan([camera], detector.gamma, 10, 20, 3, detector.delta, 0, 10, 3))
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from bluesky.protocols import Location, Reading
from event_model import DataKey
from ophyd_async.core import (
    AsyncStatus,
    LazyMock,
    MovableLogic,
    SignalR,
    StandardMovable,
    StandardReadable,
    StandardReadableFormat,
    soft_signal_r_and_setter,
    soft_signal_rw,
)

from offline_ik.beamline.combining import AXES, Combined
from offline_ik.beamline.line_client import RefusedError, Server
from offline_ik.beamline.side import LENGTHS, token_of
from offline_ik.exchange.address import parse_address

__all__ = ["Axis", "DetectorRobot"]

LOOK = 0.2  # s between two readings while it moves
PRECISION = 5


@dataclass
class _AxisLogic(MovableLogic[float]):
    """One coordinate of the robot's motion."""

    robot: DetectorRobot
    axis: str
    joined: list[Any] = field(default_factory=list)

    async def check_move(self, new_position: float) -> None:
        """Join the next motion, and wait until it is accepted: refused is refused before anything moves."""
        batch = self.robot.combined.join(**{self.axis: new_position / self.robot.scale[self.axis]})
        self.joined.append(batch)
        await self.setpoint.set(new_position)
        try:
            await batch.accepted()
        except BaseException:
            self.joined.remove(batch)
            await self.robot.refresh()
            raise

    async def move(self, new_position: float, timeout: Callable[[], float | None]) -> None:
        """Wait for the end of the motion that was joined."""
        batch = self.joined.pop(0)
        try:
            async with asyncio.timeout(timeout()):
                await self.robot.follow(batch.task)
        finally:
            await self.robot.refresh()

    async def stop(self) -> None:
        """Stop the robot: a RunEngine stops all that it moved when a plan fails, also where others move it now."""
        await self.robot.combined.stop(own=True)


class Axis(StandardMovable[float], StandardReadable):
    """One coordinate of the detector; whatever moves it moves the robot.

    Parameters
    ----------
    robot
        The device it belongs to.
    axis
        Which coordinate.
    unit
        Its unit.
    """

    def __init__(self, robot: DetectorRobot, axis: str, unit: str, name: str = "") -> None:
        with self.add_children_as_readables(StandardReadableFormat.HINTED_SIGNAL):
            self.readback, self.set_readback = soft_signal_r_and_setter(float, units=unit, precision=PRECISION)
        self.setpoint = soft_signal_rw(float, units=unit, precision=PRECISION)
        self._logic = _AxisLogic(self.setpoint, self.readback, robot, axis)
        super().__init__(name=name)

    @cached_property
    def movable_logic(self) -> _AxisLogic:
        """How it moves."""
        return self._logic

    async def check_value(self, value: float) -> None:
        """Refuse what this axis alone could not do; nothing moves.

        Raises
        ------
        RefusedError
            Why.
        """
        await self._logic.robot.check_value({self._logic.axis: value})

    async def read(self) -> dict[str, Reading[Any]]:
        """Where it is now, as measured."""
        await self._logic.robot.refresh()
        return await super().read()

    async def locate(self) -> Location[float]:
        """What was accepted, and what is measured."""
        await self._logic.robot.refresh()
        return await super().locate()


class DetectorRobot(StandardReadable):
    """The detector on its robot.

    Parameters
    ----------
    address
        HOST:PORT of ``clampid serve``.
    token_file
        With the server's token, where it has one.
    radius_unit
        ``mm``, ``m`` or ``um``.
    """

    def __init__(
        self, address: str, token_file: str | Path | None = None, radius_unit: str = "mm", name: str = ""
    ) -> None:
        if radius_unit not in LENGTHS:
            raise RefusedError(f"radius_unit: expected {', '.join(LENGTHS)}, found {radius_unit!r}")
        host, port = parse_address(address)
        self._server = Server(host, port, "bluesky", None if token_file is None else token_of(Path(token_file)))
        self.scale = {"gamma": math.degrees(1.0), "delta": math.degrees(1.0), "radius": 1.0 / LENGTHS[radius_unit]}
        units = {"gamma": "deg", "delta": "deg", "radius": radius_unit}
        self.gamma, self.delta, self.radius = (Axis(self, axis, unit) for axis, unit in units.items())
        with self.add_children_as_readables():
            spreads = {axis: soft_signal_r_and_setter(float, units=unit) for axis, unit in units.items()}
            self.gamma_std, self.delta_std, self.radius_std = (spreads[axis][0] for axis in AXES)
        self._set_std = {axis: spread[1] for axis, spread in spreads.items()}
        self.moving: SignalR[bool]
        self.moving, self._set_moving = soft_signal_r_and_setter(bool)
        self._mocked = False
        super().__init__(name=name)

    @cached_property
    def combined(self) -> Combined:
        """What moves the robot."""
        return Combined(self._server)

    @property
    def axes(self) -> dict[str, Axis]:
        """The three axes."""
        return {"gamma": self.gamma, "delta": self.delta, "radius": self.radius}

    async def connect(
        self, mock: bool | LazyMock[Any] = False, timeout: float = 10.0, force_reconnect: bool = False
    ) -> None:
        """Look where the robot is.

        Raises
        ------
        LostError
            The server does not answer.
        """
        await super().connect(mock, timeout, force_reconnect)
        self._mocked = bool(mock)
        await self.refresh()

    async def refresh(self) -> None:
        """Read where the robot is."""
        if self._mocked:
            return
        reply = await self.combined.robot()
        for axis, name in AXES.items():
            self.axes[axis].set_readback(reply["at"][name] * self.scale[axis])
            await self.axes[axis].setpoint.set(reply["setpoint"][name] * self.scale[axis])
            std = reply["at"][f"{name.removesuffix('_rad').removesuffix('_m')}_std_{name.rsplit('_', 1)[1]}"]
            self._set_std[axis](math.nan if std is None else std * self.scale[axis])
        self._set_moving(reply["moving"])

    async def follow(self, motion: asyncio.Future[Any]) -> None:
        """Show where the robot is until a motion has ended.

        Raises
        ------
        MotionError
            It did not arrive.
        """
        while not motion.done():
            await asyncio.wait({motion}, timeout=LOOK)
            await self.refresh()
        motion.result()

    def _radians(self, value: Mapping[str, float]) -> dict[str, float]:
        unknown = [key for key in value if key not in AXES]
        if unknown or not value:
            raise RefusedError(f"expected some of {', '.join(AXES)}, found {', '.join(map(str, value)) or 'none'}")
        return {axis: float(there) / self.scale[axis] for axis, there in value.items()}

    @AsyncStatus.wrap
    async def set(self, value: Mapping[str, float]) -> None:
        """Move to some of gamma, delta and radius at once; the others stay where they were asked to be."""
        batch = self.combined.join(**self._radians(value))
        await batch.accepted()
        await self.follow(batch.task)

    async def check_value(self, value: Mapping[str, float]) -> None:
        """Refuse what the server would refuse; nothing moves.

        Raises
        ------
        RefusedError
            Why.
        """
        await self.combined.check(**self._radians(value))

    async def stop(self, success: bool = True) -> None:
        """Stop a motion of this device, which fails; those of others go on (for them there is `stop` of the server)."""
        await self.combined.stop(own=True)

    async def locate(self) -> Location[dict[str, float]]:
        """What was accepted, and what is measured."""
        await self.refresh()
        found = {axis: await device.locate() for axis, device in self.axes.items()}
        return Location(
            setpoint={axis: at["setpoint"] for axis, at in found.items()},
            readback={axis: at["readback"] for axis, at in found.items()},
        )

    async def read(self) -> dict[str, Reading[Any]]:
        """The three coordinates as measured, and their standard deviations."""
        await self.refresh()
        found = await super().read()
        for axis in self.axes.values():
            found |= await axis.readback.read()
        return found

    async def describe(self) -> dict[str, DataKey]:
        """What :meth:`read` gives."""
        found = await super().describe()
        for axis in self.axes.values():
            found |= await axis.readback.describe()
        return found
