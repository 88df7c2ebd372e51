"""The recorded and derived variables that effects may depend on, and the stages whose rows have them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from experiments.columns import is_further

__all__ = ["PRESLIDING_LENGTHS", "RELAXATION_TIMES", "SIGNALS", "Signal", "Stage", "signal"]

Stage = str
"""The name of a stage: see :mod:`clampid.stages.stage_kind`."""

PRESLIDING_LENGTHS: tuple[float, ...] = (2.15e-4, 4.64e-4, 1e-3, 2.15e-3, 4.64e-3, 1e-2, 2.15e-2, 4.64e-2)
"""Presliding lengths at the motor, rad, at which the states of dry friction are at hand (signal ``dry_state``)."""
RELAXATION_TIMES: tuple[float, ...] = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
"""Times in which these states relax at rest, s; every length goes with every time, times running faster."""


@dataclass(frozen=True)
class Signal:
    """One recorded or derived variable, a value of it per row.

    The shape may name ``n`` (joints), ``m`` (targets), ``a`` (anchors) and ``s`` (sessions).
    ``sided``: it says from which side a joint or motor came, or on which side it presses.
    """

    shape: tuple[str | int, ...]
    unit: str
    meaning: str
    sided: bool = False


SIGNALS: Mapping[str, Signal] = {
    "q": Signal(("n",), "rad", "joint angles as the controller reports them"),
    "motor": Signal(("n",), "rad", "motor-shaft angles, T^-T q"),
    "direction": Signal(("n",), "", "direction of the last motion of each joint: +1, -1, 0 unknown", sided=True),
    "reversal_way": Signal(
        ("n",), "rad", "way of each joint since it last turned back, by the order of the visits; 100 if unknown"
    ),
    "turned_back": Signal(("n",), "", "1 if a joint's last motion was against its way from the visit before, else 0"),
    "torque": Signal(
        ("n",), "Nm", "joint torque that the drive exerts: +dV/dq at rest, with that of acceleration in motion"
    ),
    "inertia_torque": Signal(("n",), "Nm", "joint torque that the bodies described take in acceleration and at speed"),
    "flank": Signal(("n",), "", "side on which the transmitted torque presses, -1 to +1", sided=True),
    "joint_speed": Signal(("n",), "rad/s", "speed of the joints"),
    "motor_speed": Signal(("n",), "rad/s", "speed of the motors, T^-T w_joint"),
    "joint_motion": Signal(("n",), "", "sign of the joint's present or, at standstill, last motion", sided=True),
    "motor_motion": Signal(("n",), "", "sign of the motor's present or, at standstill, last motion", sided=True),
    "dry_state": Signal(
        ("n", len(PRESLIDING_LENGTHS) * len(RELAXATION_TIMES)),
        "",
        "state of each motor's dry friction, -1 to +1, for every presliding length and relaxation time",
    ),
    "own_speed": Signal(("n",), "rad/s", "speed that each motor would have if its own joint alone turned it"),
    "own_motion": Signal(("n",), "", "sign of that speed or, at standstill, of the last such motion", sided=True),
    "joint_acceleration": Signal(("n",), "rad/s^2", "acceleration of the joints"),
    "torque_rate": Signal(("n",), "Nm/s", "rate of the torque that the weight described takes at the motors"),
    "inclination_torque": Signal(
        ("n", 2), "Nm/rad", "torque that the weight described takes by inclination of the base about horizontal axes"
    ),
    "axis_torque": Signal(
        ("n", "2n"),
        "Nm/rad",
        "torque that the weight described takes by two tilts of each joint's axis; of joint 1 zero",
    ),
    "regressor": Signal(("n", "4n"), "m/s^2, 1/s^2", "d tau_joint / d (m, m c) of each link"),
    "link_inertia_regressor": Signal(("n", "6n"), "1/s^2", "d tau_joint / d (Ixx, Iyy, Izz, Ixy, Ixz, Iyz) of links"),
    "tool_regressor": Signal(("n", 4), "m/s^2, 1/s^2", "d tau_joint / d (m, m c) of the tool, flange frame"),
    "base_moment": Signal((3,), "Nm", "moment of the weight of all that moves, about the base's origin, base frame"),
    "transverse_moment": Signal(
        ("n", 3), "Nm", "moment across each joint's axis, in the link behind it, base axes at the zero pose"
    ),
    "link_moment": Signal(("n", 3), "Nm", "moment that each link's far end carries, base axes at the zero pose"),
    "link_force": Signal(("n", 3), "N", "force that each link's far end carries, base axes at the zero pose"),
    "wrench": Signal((6,), "Nm, N", "moment and force of the clamped flange on the fixture, base frame"),
    "link_temperature": Signal(("n",), "K", "temperature of each link less 20 degC"),
    "motor_temperature": Signal(("n",), "K", "temperature of each motor less 20 degC"),
    "ambient_temperature": Signal((), "K", "temperature of the surroundings less 20 degC"),
    "elapsed": Signal((), "s", "time since the first row"),
    "fixture_motion": Signal((6,), "rad, m", "motion (w, v) of the clamped flange by a sensor, base frame; else zero"),
    "slip": Signal(
        ("n", 3), "", "states, -1 to +1, of what slips after 10, 30, 80 % of the amplitude of a sweep's load"
    ),
    "sweep_fraction": Signal((), "", "how far the sweep has come, 0 to 1"),
    "sweep_progress": Signal((), "", "sweeps before this one, and the share of its rows that came before: s to s + 1"),
    "target_is": Signal(("m",), "", "1 for the target that the row measured, else 0"),
    "anchor_is": Signal(("a",), "", "1 for the anchor that the row's distance was measured from, else 0"),
    "anchor_way": Signal((3,), "", "unit vector from that anchor to the target, instrument's frame; of points zero"),
    "session_is": Signal(("s",), "", "1 for the session that the row belongs to, else 0"),
    "position": Signal((3,), "m", "the nominal robot's point in the instrument's frame"),
}
"""What an effect may depend on, name by name; beside these every other recorded temperature, see :func:`signal`."""

_SENSOR = re.compile(r"temp_(?!(link|motor)\d+$|ambient$)[A-Za-z]\w*")


def signal(name: str) -> Signal | None:
    """The signal of a name; None if there is none.

    ``temp_<where>`` is what a column ``temp_<where>_C`` recorded, if it is of no link, motor or the surroundings. In
    poses every other column whose name ends in a unit is a signal of that name.
    """
    if name in SIGNALS:
        return SIGNALS[name]
    if _SENSOR.fullmatch(name):
        return Signal((), "K", f"temperature of {name.removeprefix('temp_')} less 20 degC, as recorded")
    return Signal((), "", f"column {name}, as recorded") if is_further(name) else None
