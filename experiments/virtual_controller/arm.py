"""The robot behind the controller: an individual with hidden effects, and the readings of its sensors at any time.

Which individual it is follows from the seed as in `experiments.virtual_robot.measure`: a model identified from
``clampid simulate --seed N --hide …`` is a model of the robot that ``clampid virtual-robot --seed N --hide …`` plays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from experiments.virtual_controller.clamping import Clamping, close_clamp, gauges, held_torques
from experiments.virtual_controller.errors import ControllerError
from experiments.virtual_controller.moves import Limits, limits_of, move
from experiments.virtual_controller.noise import Noise
from experiments.virtual_controller.track import Rows, Track
from experiments.virtual_controller.warmth import Warmth
from experiments.virtual_robot import Hidden, RobotDescription
from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.description import Array
from experiments.virtual_robot.draw import draw_plant
from experiments.virtual_robot.drive import arm_at_rest, motor_angles
from experiments.virtual_robot.heat import Temperatures
from experiments.virtual_robot.hidden import hide
from experiments.virtual_robot.measure import declared
from experiments.virtual_robot.pose_tables import tracked_points
from experiments.virtual_robot.remeasured import FIRST_VISIT, seeds_of, set_up_anew
from experiments.virtual_robot.sampling import Site
from experiments.virtual_robot.torque_tables import moving_torques

__all__ = ["AXES", "SAMPLE_S", "Arm", "Readings"]

AXES = 6
SAMPLE_S = 0.012  # s between two samples of the recording
COUNT = 2 * np.pi / 2**16  # rad at the motor: one count of its encoder
FLICKER = 0.3  # counts, of the encoder's reading
RATED_CURRENT = 12.0  # A at a motor's rated torque
KELVIN = 273.15
MEMORY = 300.0  # s for which moves are remembered: more than the recording holds
LAST_TORQUE_DIGIT = 1e-4  # Nm and A


@dataclass(frozen=True)
class Readings:
    """What the controller reads at some times, (N, 6) each.

    Attributes
    ----------
    axis
        ``$AXIS_ACT_MEAS``, deg.
    torque
        ``$TORQUE_AXIS_ACT``, Nm at the motors.
    current
        ``$CURR_ACT``, A.
    """

    axis: Array
    torque: Array
    current: Array


class Arm:
    """One robot from switch-on.

    Parameters
    ----------
    robot
        The nominal robot; six axes. Without masses it has no weight, and torques are those of friction.
    hidden
        Effects that this individual has.
    seed, session
        Which individual, and where instrument and tool are: as for `measure`.
    posture
        Where it stands at switch-on, rad, (6,); in the middle of its ranges if not given.

    Raises
    ------
    ControllerError
        The robot has not six axes, or an effect cannot be hidden in it.
    """

    def __init__(
        self,
        robot: RobotDescription,
        hidden: Sequence[Hidden] = (),
        *,
        seed: int = 0,
        session: int = FIRST_VISIT,
        posture: Array | None = None,
    ) -> None:
        if len(robot.joints) != AXES:
            raise ControllerError(f"{robot.name}: expected a robot with {AXES} axes, found {len(robot.joints)}")
        site = Site(robot)
        try:
            seeds = seeds_of(seed, session)
            baseline = draw_plant(robot, np.random.default_rng(seeds.plant))
            plant, self.hidden = hide(site, baseline, hidden, seeds.hidden)
        except ValueError as error:
            raise ControllerError(str(error)) from error
        self.plant = set_up_anew(robot, plant, seeds.place)
        self.robot, self.seed = robot, seed
        self.bodies = Bodies(self.plant.geometry, self.plant.masses)
        self.limits: Limits = limits_of(robot)
        self._entropy = int(np.random.SeedSequence([seed, session, 27]).generate_state(1)[0])
        self.rng = np.random.default_rng([self._entropy, 0])
        start = site.middle if posture is None else np.asarray(posture, dtype=float)
        self.track = Track(self.plant, self.limits, start, self.rng)
        self.warmth = Warmth(self.plant.heat, self.limits.speed, self.track.travel)
        self._clampings: list[Clamping] = []
        self._rated = self.plant.drive.rated * np.abs(np.diag(self.plant.drive.nominal))  # Nm at the motors
        self.boot_noise(0)

    def boot_noise(self, boot: int) -> None:
        """Begin another stream of the noise of sensors."""
        self._noise = Noise((self._entropy, 1, boot), AXES, SAMPLE_S)
        self._flicker = Noise((self._entropy, 2, boot), AXES, SAMPLE_S)

    def declared(self) -> dict[str, Any]:
        """Return what the cell declares of gravity, tool, targets and instrument."""
        return declared(self.plant)

    def go(self, now: float, target: Array, share: float) -> float:
        """Plan a move after those planned already; return when it ends, s."""
        one = move(self.limits, max(now, self.track.end), self.track.target, target, share)
        self.track.add(one)
        return one.end

    def tidy(self, now: float) -> None:
        """Compute the temperatures until now, and drop data that cannot be requested any more."""
        self.warmth.advance(now)
        self.track.forget(min(now - MEMORY, self.warmth.time))

    def read(self, times: Sequence[float], rows: list[int], powered: bool = True) -> Readings:
        """Return what is read at times that have passed.

        Parameters
        ----------
        times
            s, (N,).
        rows
            Numbers of the samples, (N,): the same number has the same noise.
        powered
            Whether the drives are on; without them there is no torque to read.
        """
        drive, lag = self.plant.drive, self.plant.friction.lag
        now = self.track.at(times)
        counts = motor_angles(drive, now.q) / COUNT + FLICKER * self._flicker.white(rows)
        axis = np.degrees(np.round(counts) * COUNT @ drive.nominal)
        if not powered:
            nothing = np.zeros_like(axis)
            return Readings(axis, nothing, nothing)
        before = [max(time - lag, 0.0) for time in times]
        shaft = self._shaft(before, self.track.at(before) if lag else now)
        torque = shaft + self.plant.instrument.torque_sigma * self._noise.torque(rows)
        current = shaft + self.plant.instrument.torque_sigma * self._flicker.torque(rows)
        return Readings(axis, _digits(torque), _digits(current * RATED_CURRENT / self._rated))

    def _shaft(self, times: list[float], rows: Rows) -> Array:
        """Torques at the motors without noise, Nm, (N, 6): of a free arm, or of a clamped one."""
        warm = self.warmth.motor(times)
        clampings = [self.clamped(time) for time in times]
        if clampings[0] is None and not any(clampings):
            return moving_torques(
                self.plant,
                self.bodies,
                (rows.q, rows.qd, rows.qdd),
                state=rows.motor_state,
                gear_state=rows.gear_state,
                temperature=warm,
            )
        if clampings[0] is not None and all(each is clampings[0] for each in clampings):
            return held_torques(self.plant, self.bodies, clampings[0], times, rows, warm)
        single = [self._shaft([time], self.track.at([time])) for time in times]  # closed or opened in between
        return np.vstack(single)

    def clamped(self, time: float) -> Clamping | None:
        """Return how the flange is clamped at a time, if it is."""
        return next((each for each in reversed(self._clampings) if each.start <= time < each.end), None)

    def clamp(self, now: float) -> None:
        """Clamp the flange of the robot, which stands."""
        rows = self.track.at([now])
        self._clampings = [each for each in self._clampings if each.end > now - MEMORY]
        self._clampings.append(close_clamp(self.plant, self.bodies, now, rows, self.rng))

    def release(self, now: float) -> None:
        """Open the clamp."""
        if self._clampings and math.isinf(self._clampings[-1].end):
            self._clampings[-1] = replace(self._clampings[-1], end=now)

    def slip(self, now: float, shift: Sequence[float]) -> None:
        """Let the block that holds the flange slip by a shift, m, (3,)."""
        clamping = self.clamped(now)
        if clamping is None:
            raise ControllerError("the flange is not clamped")
        further = np.concatenate([shift, np.zeros(3)])
        self._clampings[-1] = replace(clamping, slipped=(*clamping.slipped, (now, further)))

    def rock(self, now: float, tilt: Sequence[float]) -> None:
        """Let the block that holds the flange rock from now on; from rest to rest by a tilt, m, (3,)."""
        clamping = self.clamped(now)
        if clamping is None:
            raise ControllerError("the flange is not clamped")
        self._clampings[-1] = replace(clamping, rocks=(now, np.concatenate([tilt, np.zeros(3)])))

    def gauges(self, now: float) -> Array | None:
        """Return the readings of the dial gauges at the block, m and rad, (6,), with noise; None: no clamp."""
        clamping = self.clamped(now)
        if clamping is None:
            return None
        true = gauges(self.plant, self.bodies, clamping, now, self.track.at([now]).q[0])
        return np.asarray(true + self.plant.fixture.sigma * self.rng.standard_normal(6), dtype=float)

    def motor_kelvin(self, time: float) -> Array:
        """Return ``$MOT_TEMP``, K, (6,): whole kelvins."""
        return np.asarray(np.round(self.warmth.motor([time])[0] + KELVIN), dtype=float)

    def climate(self, time: float) -> Temperatures:
        """Return the true temperatures at a time, °C."""
        return self.warmth.at([max(time, 0.0)])

    def points(self, times: Sequence[float]) -> Array:
        """Return the targets in the instrument's frame without noise of the instrument, m, (N, targets, 3)."""
        rows = self.track.at(times)
        if self.plant.drive.slip.any():  # springs with hysteresis depend on earlier postures
            arm = np.array([self._slipped(time) for time in times])
        else:
            arm, _ = arm_at_rest(self.plant, self.bodies, rows.q, rows.direction)
        for place, time in enumerate(times):
            if (clamping := self.clamped(time)) is not None:
                arm[place] = clamping.arm
        warm = self.warmth.at([max(time, 0.0) for time in times]).link
        return tracked_points(self.plant, self.bodies, arm + rows.off, warm, np.maximum(np.asarray(times), 0.0))

    def _slipped(self, time: float) -> Array:
        q, direction = self.track.stood(time)
        return np.asarray(arm_at_rest(self.plant, self.bodies, q, direction)[0][-1], dtype=float)


def _digits(values: Array) -> Array:
    return np.asarray(np.round(values / LAST_TORQUE_DIGIT) * LAST_TORQUE_DIGIT, dtype=float)


def rows_at(times: Sequence[float], since: float) -> list[int]:
    """Return the numbers of the last samples before times, s, of a recording that began at ``since``."""
    return [max(math.floor((time - since) / SAMPLE_S + 1e-9), 0) for time in times]
