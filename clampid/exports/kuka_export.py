"""The compensated robot as KUKA machine data, and in numbers what that form cannot hold.

The form (:mod:`kinematics.kuka`) has 22 of the 30 numbers that six axes and a flange need. Axis 2 stays perpendicular
to axis 1 and parallel to axis 3, and the wrist's axes stay perpendicular and meet: eight numbers that a calibrated arm
has are lost. The 22 are those that come nearest to the calibrated chain over the joints' ranges, which makes up for a
part of the eight. What is left is measured at other postures, on the text as it was written and read back, and stands
in it: of the static geometry, which is the form's own fault, and of the whole model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from clampid.exports.determined import fix_undetermined
from clampid.exports.form_error import (
    CHECKED,
    FormError,
    LeftOut,
    Measured,
    form_error,
    left_out,
    measured_error,
    postures,
)
from clampid.models.calibrated import CalibratedChain, calibrated_chain, sensitivity
from clampid.models.described import robot_of
from clampid.models.model import Model, ModelError
from clampid.stages.rows import Array
from experiments.campaign import Campaign
from experiments.temperatures import REFERENCE_TEMPERATURE
from kinematics.kuka import MachineData, forward, frame_numbers, nominal_machine_data
from kinematics.kuka_text import machine_data_text, read_machine_data
from kinematics.robot import RobotDescription
from kinematics.screws import inverse, log_so3

__all__ = ["KukaExport", "kuka_machine_data"]

LEVER = 0.2  # m, from the flange to a tool's point
FITTED = 400  # postures, drawn apart from those that the error is measured at
READ_BACK = 1e-8  # m and rad: what the digits of the text may cost
FRAMES = ("tiroro", "tflwp")
LENGTHS = ("length_a", "length_b")
MASTERED = (1, 2, 3, 4)  # joints, from 0; the outer two turn with base and flange, whose frames take them
WRIST = (0, 1, 2, 5)  # of $TX3P3: X, Y, Z and C; A and B turn with axes 4 and 3, whose mastering takes them


@dataclass(frozen=True)
class KukaExport:
    """Machine data nearest to a model.

    Attributes
    ----------
    data
        As they are read back from the text.
    text
        The part of a ``$machine.dat``.
    left
        What the form alone leaves of the static geometry.
    nominal
        What the nominal machine data leave of it, with the best base and flange.
    whole
        What these data leave of the whole model.
    on_points
        What a controller with these data alone leaves of measured points; None without a campaign.
    """

    data: MachineData
    text: str
    left: FormError
    nominal: FormError
    whole: LeftOut
    on_points: Measured | None = None


def kuka_machine_data(
    model: Model,
    *,
    session: int = 0,
    robot: RobotDescription | None = None,
    temperature: float = REFERENCE_TEMPERATURE,
    lever: float = LEVER,
    campaign: Campaign | None = None,
    user_effects: Path | None = None,
) -> KukaExport:
    """The machine data of a KUKA controller that come nearest to a model, with standard errors.

    Parameters
    ----------
    session
        Whose base and flange, from 0.
    robot
        The nominal robot, if the model's name for it is not that of a bundled one.
    temperature
        Of all links, °C; another than 20 needs expansion to have been identified.
    lever
        How far a tool's point is from the flange, m: orientation counts in the fit as what it moves there.
    campaign
        That of the session: its declared tool loads the model, and on its measured points it is said what these data
        alone leave, deflection included.
    user_effects
        The user's own effects; by default the file that the model names.

    Raises
    ------
    ModelError
        The model has no geometry, no expansion for that temperature, or effects that are not known; the campaign is not
        that of the session; or the text, read back, is not what was fitted.
    MachineDataError
        The robot has not six joints, or its nominal arm is not ortho-parallel with a central hand.

    Notes
    -----
    Source: KUKA2005 for the form; the fit is least squares over position and ``lever`` times orientation.
    """
    nominal = robot_of(model, robot)
    if not 0 < lever < np.inf:
        raise ModelError(f"lever: expected a length above 0 m, found {lever:g}")
    start = nominal_machine_data(nominal)
    model = fix_undetermined(model).model
    chain = calibrated_chain(model, session=session, robot=nominal, temperature=temperature)
    fit = _Fit(postures(nominal, FITTED), lever)
    start = replace(start, robroot=frame_numbers(chain.base))
    fitted = _nearest(start, chain, fit, every=True)
    std = _standard_errors(fitted, model, chain, fit, session, temperature)
    fresh = postures(nominal, CHECKED, seed=1)
    true = chain.flange(fresh)
    plain = form_error(true, forward(_nearest(start, chain, fit, every=False), fresh))
    data = read_machine_data(machine_data_text(fitted, std))
    lost = float(np.abs(forward(data, fresh) - forward(fitted, fresh)).max())
    if not lost <= READ_BACK:
        raise ModelError(f"the machine data, read back, differ by {lost:.2g} m from what was written")
    left = form_error(true, forward(data, fresh))

    def form(q: Array) -> Array:
        return np.asarray(forward(data, q))

    on_points = None if campaign is None else measured_error(form, model, session, campaign)
    whole = left_out(
        form, model, nominal, session=session, temperature=temperature, campaign=campaign, user_effects=user_effects
    )
    said = _header(nominal.name, temperature, (left, plain), whole, lever)
    said += [] if on_points is None else [f"These data alone leave {on_points}"]
    text = machine_data_text(fitted, std, [*said, ""])
    return KukaExport(data, text, left, plain, whole, on_points)


def _header(
    name: str, temperature: float, errors: tuple[FormError, FormError], whole: LeftOut, lever: float
) -> list[str]:
    """What a reader of the file has to know; ASCII, as a controller's files are."""
    return [
        f"clampid: static geometry of {name} at {temperature:g} degC as KUKA machine data",
        "Form: KUKA, KR C2 operating handbook, Machine Data (2005): articulated arm #NR, central hand #ZEH.",
        "mm and degrees, with standard errors. A part of $machine.dat, to be put into it by hand.",
        "This form keeps axes 1 and 2 perpendicular, 2 and 3 parallel, and the wrist's axes perpendicular and through",
        f"one point. What that leaves of the static flange, at {CHECKED} postures in the joints' ranges, read back:",
        f"  {errors[0]}",
        "What nominal machine data leave, with the best base and flange:",
        f"  {errors[1]}",
        f"Both come nearest for a tool's point {1e3 * lever:g} mm from the flange.",
        f"In no machine data, and not in these numbers: {whole.worth}.",
        f"With these, {whole.conditions}:",
        f"  {whole.error}",
        "$ROBROOT is the robot's base in the instrument's frame. Mastering is the last block: each axis' own $MAMES,",
        "plus what is said there. Axes 1 and 6 keep theirs: $TIRORO and $TFLWP have what turns with them.",
    ]


def _numbers(data: MachineData) -> Array:
    """What is fitted (22,): $TIRORO and $TFLWP, the lengths, four of $TX3P3 and the mastering of axes 2 to 5."""
    frames = [getattr(data, name) for name in FRAMES]
    lengths = [getattr(data, name) for name in LENGTHS]
    return np.concatenate([*frames, lengths, data.tx3p3[list(WRIST)], data.mastering[list(MASTERED)]])


def _with_numbers(data: MachineData, numbers: Array) -> MachineData:
    """The same data with other values for `_numbers`."""
    tx3p3, mastering = np.array(data.tx3p3), np.array(data.mastering)
    tx3p3[list(WRIST)] = numbers[14:18]
    mastering[list(MASTERED)] = numbers[18:22]
    return replace(
        data,
        tiroro=numbers[:6],
        tflwp=numbers[6:12],
        length_a=float(numbers[12]),
        length_b=float(numbers[13]),
        tx3p3=tx3p3,
        mastering=mastering,
    )


def _differences(data: MachineData, chain: CalibratedChain, q: Array) -> tuple[Array, Array]:
    """Position [m] and rotation vector [rad] from the chain to the form, ``(N, 3)`` each, in the flange's axes."""
    away = inverse(chain.flange(q)) @ forward(data, q)
    return away[:, :3, 3], log_so3(away[:, :3, :3])


@dataclass(frozen=True)
class _Fit:
    """Where a form is compared with a chain: at joint angles ``q`` ``(N, 6)``, orientation counting by a lever [m]."""

    q: Array
    lever: float

    def rows(self, data: MachineData, chain: CalibratedChain) -> Array:
        position, rotation = _differences(data, chain, self.q)
        return np.concatenate([position.ravel(), self.lever * rotation.ravel()])


def _nearest(start: MachineData, chain: CalibratedChain, fit: _Fit, every: bool) -> MachineData:
    """The form nearest to the chain; of the numbers all (``every``) or base and flange only."""
    begin = _numbers(start)
    free = slice(None) if every else slice(0, 12)

    def rows(values: Array) -> Array:
        numbers = begin.copy()
        numbers[free] = values
        return fit.rows(_with_numbers(start, numbers), chain)

    found = least_squares(rows, begin[free], method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    numbers = begin.copy()
    numbers[free] = found.x
    return _with_numbers(start, numbers)


def _standard_errors(
    data: MachineData, model: Model, chain: CalibratedChain, fit: _Fit, session: int, temperature: float
) -> dict[str, Array]:
    """Those of every number that is a result, from the model's covariance; nan for the others.

    The fit gives rows(n, theta) = least, so that n follows theta by -J^+ d rows/d theta (implicit function theorem; the
    rows' own curvature is left out, because what the form leaves is small beside the arm).
    """
    begin = _numbers(data)
    step = 1e-7
    J = np.array(
        [
            (fit.rows(_with_numbers(data, begin + e), chain) - fit.rows(_with_numbers(data, begin - e), chain))
            / (2 * step)
            for e in step * np.eye(len(begin))
        ]
    ).T
    inside = replace(data, robroot=np.zeros(6))  # the base is the chain's own, and cancels

    def seen(moved: CalibratedChain) -> Array:
        in_base = CalibratedChain(moved.robot, np.eye(4), moved.screws, moved.home)
        return np.concatenate([fit.rows(inside, in_base), frame_numbers(moved.base)])

    def apart(a: Array, b: Array) -> Array:  # angles the short way; what moves by a step moves by less than a turn
        return np.asarray(np.pi - np.remainder(np.pi - (a - b), 2 * np.pi))

    D, covariance = sensitivity(
        model, seen, session=session, robot=chain.robot, temperature=temperature, difference=apart
    )
    G = np.concatenate([-np.linalg.lstsq(J, D[:-6], rcond=None)[0], D[-6:]])
    std = np.sqrt(np.maximum(np.einsum("ik,kl,il->i", G, covariance, G), 0.0))
    tx3p3, mastering = np.full((2, 6), np.nan)
    tx3p3[list(WRIST)], mastering[list(MASTERED)] = std[14:18], std[18:22]
    lengths = {name: std[12 + k : 13 + k] for k, name in enumerate(LENGTHS)}
    return {
        "tiroro": std[:6],
        "tflwp": std[6:12],
        "tx3p3": tx3p3,
        "mastering": mastering,
        "robroot": std[22:],
        **lengths,
    }
