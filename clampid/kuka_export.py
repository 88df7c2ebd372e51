"""The compensated robot as KUKA machine data, and in numbers what that form cannot hold.

The form (:mod:`kinematics.kuka`) has 22 of the 30 numbers that six axes and a flange need. Axis 2 stays perpendicular
to axis 1 and parallel to axis 3, and the wrist's axes stay perpendicular and meet: eight numbers that a calibrated arm
has are lost. The 22 are those that come nearest to the calibrated chain over the joints' ranges, which makes up for a
part of the eight. What is left is measured at other postures, on the text as it was written and read back, and stands
in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from clampid.export import CalibratedChain, calibrated_chain, postures, sensitivity
from clampid.model import Model, ModelError
from clampid.slots import Slot
from clampid.stages.rows import Array
from experiments.campaign import Campaign, target_points
from experiments.metrics import norm_metrics
from kinematics.description import load_robot
from kinematics.kuka import MachineData, forward, frame_numbers, nominal_machine_data
from kinematics.kuka_text import machine_data_text, read_machine_data
from kinematics.robot import RobotDescription
from kinematics.screws import inverse, log_so3

__all__ = ["FormError", "KukaExport", "kuka_machine_data"]

LEVER = 0.2  # m, from the flange to a tool's point
FITTED, CHECKED = 400, 2000  # postures, drawn apart
READ_BACK = 1e-8  # m and rad: what the digits of the text may cost
FRAMES = ("tiroro", "tflwp")
LENGTHS = ("length_a", "length_b")
MASTERED = (1, 2, 3, 4)  # joints, from 0; the outer two turn with base and flange, whose frames take them
WRIST = (0, 1, 2, 5)  # of $TX3P3: X, Y, Z and C; A and B turn with axes 4 and 3, whose mastering takes them


@dataclass(frozen=True)
class FormError:
    """How far a form is from the calibrated chain, over postures: the flange's position [m] and orientation [rad]."""

    position_rms: float
    position_max: float
    orientation_rms: float
    orientation_max: float

    def __str__(self) -> str:
        return (
            f"position rms {1e3 * self.position_rms:.4f} mm, max {1e3 * self.position_max:.4f} mm; "
            f"orientation rms {1e3 * self.orientation_rms:.4f} mrad, max {1e3 * self.orientation_max:.4f} mrad"
        )


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
        What the nominal machine data leave, with the best base and flange.
    measured
        What a controller with these data alone leaves of measured poses, in a sentence; empty without a campaign.
    """

    data: MachineData
    text: str
    left: FormError
    nominal: FormError
    measured: str = ""


def kuka_machine_data(
    model: Model,
    *,
    session: int = 0,
    robot: RobotDescription | None = None,
    temperature: float = 20.0,
    lever: float = LEVER,
    left_out: Sequence[str] = (),
    campaign: Campaign | None = None,
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
    left_out
        Effects of the model that no static geometry holds: they are named in the text.
    campaign
        That of the session: on its measured points it is said what these data alone leave, deflection included.

    Raises
    ------
    ModelError
        The model has no geometry, or no expansion for that temperature; the campaign is not that of the session; or the
        text, read back, is not what was fitted.
    MachineDataError
        The robot has not six joints, or its nominal arm is not ortho-parallel with a central hand.

    Notes
    -----
    Source: KUKA2005 for the form; the fit is least squares over position and ``lever`` times orientation.
    """
    nominal = load_robot(model.robot) if robot is None else robot
    if not 0 < lever < np.inf:
        raise ModelError(f"lever: expected a length above 0 m, found {lever:g}")
    start = nominal_machine_data(nominal)
    chain = calibrated_chain(model, session=session, robot=nominal, temperature=temperature)
    fit = _Fit(postures(nominal, FITTED), lever)
    start = replace(start, robroot=frame_numbers(chain.base))
    fitted = _nearest(start, chain, fit, every=True)
    std = _standard_errors(fitted, model, chain, fit, session, temperature)
    fresh = postures(nominal, CHECKED, seed=1)
    plain = _error(_nearest(start, chain, fit, every=False), chain, fresh)
    data = read_machine_data(machine_data_text(fitted, std))
    lost = float(np.abs(forward(data, fresh) - forward(fitted, fresh)).max())
    if not lost <= READ_BACK:
        raise ModelError(f"the machine data, read back, differ by {lost:.2g} m from what was written")
    left = _error(data, chain, fresh)
    measured = "" if campaign is None else _measured(data, model, session, campaign)
    said = _header(nominal.name, temperature, (left, plain), left_out, lever)
    text = machine_data_text(fitted, std, [*said, *([measured] if measured else []), ""])
    return KukaExport(data, text, left, plain, measured)


def _header(
    name: str, temperature: float, errors: tuple[FormError, FormError], left_out: Sequence[str], lever: float
) -> list[str]:
    """What a reader of the file has to know; ASCII, as a controller's files are."""
    return [
        f"clampid: static geometry of {name} at {temperature:g} degC as KUKA machine data",
        "Form: KUKA, KR C2 operating handbook, Machine Data (2005): articulated arm #NR, central hand #ZEH.",
        "mm and degrees, with standard errors. A part of $machine.dat, to be put into it by hand.",
        "This form keeps axes 1 and 2 perpendicular, 2 and 3 parallel, and the wrist's axes perpendicular and through",
        f"one point. What that leaves of the model's flange, at {CHECKED} postures in the joints' ranges, read back:",
        f"  {errors[0]}",
        "What nominal machine data leave, with the best base and flange:",
        f"  {errors[1]}",
        f"Both come nearest for a tool's point {1e3 * lever:g} mm from the flange.",
        f"In no machine data, and not in these numbers: {', '.join(left_out) or 'nothing of this model'}.",
        "$ROBROOT is the robot's base in the instrument's frame. Mastering is the last block: each axis' own $MAMES,",
        "plus what is said there. Axes 1 and 6 keep theirs: $TIRORO and $TFLWP have what turns with them.",
    ]


def _measured(data: MachineData, model: Model, session: int, campaign: Campaign) -> str:
    """How far these data are from the measured points of a session's campaign; of held-out ones, where there are."""
    if model.sessions[session].fingerprint != campaign.fingerprint:
        raise ModelError(
            f"{campaign.name}: expected the campaign that session {session + 1} of the model was fitted on, because "
            "its base and flange are in the file"
        )
    table = "verification" if "verification" in campaign.tables else "poses"
    frame, n = campaign.tables[table], campaign.robot.n
    prefix = f"session{session + 1}:" if len(model.sessions) > 1 else ""
    values = model.stages["poses"].values()
    shift = np.array(
        [
            [values.get(Slot("geometry", f"target_{a}", f"{prefix}{name}"), 0.0) for a in "xyz"]
            for name in frame["target"]
        ]
    )
    pose = forward(data, frame[[f"q{i + 1}_rad" for i in range(n)]].to_numpy(float))
    point = np.einsum("nij,nj->ni", pose[:, :3, :3], target_points(campaign, table) + shift) + pose[:, :3, 3]
    error = norm_metrics(np.linalg.norm(frame[["x_m", "y_m", "z_m"]].to_numpy(float) - point, axis=1))
    mean, largest = (1e3 * float(error[k] or 0.0) for k in ("P_mean", "P_max"))
    return (
        f"These data alone leave of {len(frame)} measured points ({table}): mean {mean:.4f} mm, max {largest:.4f} mm."
    )


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
    """Where a form is held against a chain: at joint angles ``q`` ``(N, 6)``, orientation counting by a lever [m]."""

    q: Array
    lever: float

    def rows(self, data: MachineData, chain: CalibratedChain) -> Array:
        position, rotation = _differences(data, chain, self.q)
        return np.concatenate([position.ravel(), self.lever * rotation.ravel()])


def _error(data: MachineData, chain: CalibratedChain, q: Array) -> FormError:
    sizes = [np.linalg.norm(part, axis=1) for part in _differences(data, chain, q)]
    (p_rms, p_max), (r_rms, r_max) = ((float(np.sqrt(np.mean(s**2))), float(s.max())) for s in sizes)
    return FormError(p_rms, p_max, r_rms, r_max)


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
