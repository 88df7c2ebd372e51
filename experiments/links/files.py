"""Everything that goes onto a KUKA controller for its links, as texts by file name."""

from __future__ import annotations

import ipaddress
import math
from collections.abc import Mapping

import numpy as np

from experiments.links.eki_config import config_text
from experiments.links.krl_motion import CLOCK_TIMER, WATCHDOG_TIMER, motion_dat, motion_src
from experiments.links.krl_state import state_sub
from experiments.links.read_me import read_me
from experiments.links.rsi_config import RSI_PORT, rsi_config_text
from experiments.links.schema import AXES, CHANNELS, PORT
from kinematics.escaping import for_krl
from kinematics.kuka import MachineDataError, nominal_machine_data
from kinematics.robot import DescriptionError, RobotDescription

__all__ = ["FIRST_PORT", "LAST_PORT", "link_files"]

FIRST_PORT, LAST_PORT = 54600, 54615
"""Of EthernetKRL on the controller."""
LIMIT_MARGIN = 1e-4  # deg by which limits are rounded inward: their last written digit
LISTENER = "192.168.1.10"  # of this suite in the RSI file, if no address is given: to be replaced


def link_files(robot: RobotDescription, port: int = PORT, address: str = "", listener: str = "") -> Mapping[str, str]:
    """Write the controller's side of the links.

    Parameters
    ----------
    robot
        Its axis limits go into the program.
    port
        Of the motion channel; the state channel has the next one.
    address
        The controller's own, if it is to listen there only.
    listener
        Where an RSI stream is to go.

    Returns
    -------
    Mapping
        Text by file name; ASCII.

    Raises
    ------
    DescriptionError
        The robot is no six-axis arm of KUKA's form, or a joint has no limits.
    ValueError
        A port or an address that cannot be.
    """
    if not FIRST_PORT <= port < LAST_PORT:
        raise ValueError(f"port: expected {FIRST_PORT} to {LAST_PORT - 1}, as EthernetKRL allows, found {port}")
    for name, given in (("address", address), ("listener", listener)):
        if given:
            try:
                ipaddress.IPv4Address(given)
            except ValueError:
                raise ValueError(f"{name}: expected an IPv4 address, found {given!r}") from None
    lower, upper = _limits(robot)
    title = for_krl(f"{robot.title} ({robot.name})")
    files = {f"{channel.name}.xml": config_text(channel, port, address) for channel in CHANNELS}
    files["clampid_motion.src"] = motion_src(title)
    files["clampid_motion.dat"] = motion_dat(title, lower, upper)
    files["clampid_state.sub"] = state_sub(title)
    files["ClampidRSI.xml"] = rsi_config_text(listener or LISTENER, RSI_PORT)
    timers = (CLOCK_TIMER, WATCHDOG_TIMER)
    files["README.txt"] = read_me(title, port, timers, [f"A{k}: {a:g} to {b:g}" for k, (a, b) in _pairs(lower, upper)])
    return files


def _limits(robot: RobotDescription) -> tuple[list[float], list[float]]:
    """Axis limits in degrees, rounded inward."""
    if robot.n != AXES:
        raise DescriptionError(f"{robot.name}: expected a six-axis arm of KUKA's form, found {robot.n} joints")
    try:
        nominal_machine_data(robot)
    except MachineDataError as error:
        raise DescriptionError(f"expected a six-axis arm of KUKA's form: {error}") from None
    lower, upper = np.degrees(robot.lower), np.degrees(robot.upper)
    for joint, low, high in zip(robot.joints, lower, upper, strict=True):
        if not (math.isfinite(low) and math.isfinite(high)):
            raise DescriptionError(f"{robot.name}: {joint.name} has no limits: the controller's program checks them")
    slack = 1e-6 * LIMIT_MARGIN  # of the conversion from degrees and back
    inward = (
        np.ceil(lower / LIMIT_MARGIN - slack / LIMIT_MARGIN) * LIMIT_MARGIN,
        np.floor(upper / LIMIT_MARGIN + slack / LIMIT_MARGIN) * LIMIT_MARGIN,
    )
    return inward[0].tolist(), inward[1].tolist()


def _pairs(lower: list[float], upper: list[float]) -> list[tuple[int, tuple[float, float]]]:
    return list(enumerate(zip(lower, upper, strict=True), 1))
