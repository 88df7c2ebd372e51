"""Builds the requested robot, and serves it until interrupted."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.virtual_controller.arm import Arm
from experiments.virtual_controller.clock import Clock
from experiments.virtual_controller.config import read_config
from experiments.virtual_controller.errors import ControllerError
from experiments.virtual_controller.faults import Fault, parse_faults
from experiments.virtual_controller.journal import Journal
from experiments.virtual_controller.serving import Address, VirtualRobot, parse_address
from experiments.virtual_robot import Hidden, RobotDescription

__all__ = ["Asked", "built", "play"]


@dataclass(frozen=True)
class Asked:
    """The settings of a virtual robot.

    Attributes
    ----------
    robot
        The nominal robot.
    configs
        Config files of EthernetKRL, name and text: of the motion channel and of the state channel.
    hide
        Effects to hide: ``effect``, ``effect@joint3``, ``effect@joint3:2.0``.
    seed, session
        Which individual, and which day, as for ``clampid simulate``.
    speed
        Simulated seconds in a second.
    listen
        ``HOST:PORT`` of the motion channel; the state channel has the next port.
    besides
        ``HOST:PORT`` of ``tracker``, ``operator`` and ``varproxy``; None: not wanted.
    faults
        What goes wrong.
    truth
        File for what is hidden and what moved.
    """

    robot: RobotDescription
    configs: tuple[tuple[str, str], ...]
    hide: tuple[str, ...] = ()
    seed: int = 0
    session: int = 1
    speed: float = 1.0
    listen: str = "127.0.0.1:0"
    besides: Mapping[str, str | None] | None = None
    faults: tuple[str, ...] = ()
    truth: Path | None = None


def built(asked: Asked) -> VirtualRobot:
    """Build the robot and its controller; nothing listens yet.

    Raises
    ------
    ControllerError
        Something asked for cannot be.
    """
    try:
        hidden = [Hidden.parse(item) for item in asked.hide]
    except ValueError as error:  # the virtual robot says every refusal as a plain ValueError
        raise ControllerError(str(error)) from error
    motion, state = (read_config(text, name) for name, text in asked.configs)
    clock = Clock(asked.speed)
    journal = Journal(asked.truth, asked.robot.name, asked.seed, asked.hide)
    posture = None if journal.posture is None else np.radians(journal.posture)
    arm = Arm(asked.robot, hidden, seed=asked.seed, session=asked.session, posture=posture)
    robot = VirtualRobot(arm, clock, (motion, state), journal)
    journal.begin(arm.hidden, {"session": asked.session, "declared": arm.declared()})
    journal.add({"event": "started", "boot": journal.boot, "time": 0.0, "at": np.degrees(arm.track.target).tolist()})
    return robot


def play(asked: Asked, say: Callable[[str], None]) -> None:
    """Serve until interrupted; says ``listening on HOST:PORT`` when everything listens, then what else does.

    Raises
    ------
    ControllerError
        Something asked for cannot be, or an address cannot be listened on.
    """
    where = parse_address(asked.listen, "--listen")
    besides = {
        name: parse_address(text, f"--{name}") for name, text in (asked.besides or {}).items() if text is not None
    }
    faults = parse_faults(asked.faults)
    asyncio.run(_serve(built(asked), where, besides, faults, say))


async def _serve(
    robot: VirtualRobot, where: Address, besides: Mapping[str, Address], faults: list[Fault], say: Callable[[str], None]
) -> None:
    serving = asyncio.ensure_future(robot.run())
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        with contextlib.suppress(NotImplementedError):  # Windows hears an interrupt by itself
            loop.add_signal_handler(number, serving.cancel)
    try:
        host, port = await robot.listen(where)
        found = [(name, *await robot.listen_besides(name, address)) for name, address in besides.items()]
        for fault in faults:
            robot.arm_fault(fault)
        say(f"listening on {host}:{port}")
        for name, *at in found:
            say(f"{name} on {at[0]}:{at[1]}")
        with contextlib.suppress(asyncio.CancelledError):
            await serving
    finally:
        serving.cancel()
        robot.close()
        await asyncio.sleep(0)  # a closed transport says so on a later turn of the loop
