"""The compensated robot for others: Denavit–Hartenberg tables with uncertainties, and URDF.

The calibrated chain (see :mod:`clampid.stages.poses`) is::

    x = X_0 M_0 prod_i exp([xi_i] q_i) M_i F

with F the flange's nominal home pose. Moving every M_i through the exponentials behind it gives screws
xi'_i = Ad(M_1 … M_{i-1}) xi_i and a home pose M_1 … M_n F: a chain as any other. It holds what is static at one
temperature of all links, 20 °C unless another is stated; effects that depend on posture, load or direction are no part
of a table (errors of joint angles have a table of their own). Where a linkage couples joints,
q are the joint values of the chain and not the controller's.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from clampid.catalogue import with_user_effects
from clampid.curves import angle_errors
from clampid.model import Model, ModelError, write_text
from clampid.slots import Slot
from clampid.stages.pose_kernel import link_points
from clampid.stages.poses import link_vectors
from clampid.stages.rows import Array
from kinematics.description import load_robot
from kinematics.dh import Convention, DHRow, DHTable
from kinematics.dh import forward as dh_forward
from kinematics.dh_conversion import DHError, hayati_from_poe, standard_from_poe
from kinematics.poe import forward
from kinematics.robot import RobotDescription
from kinematics.screws import adjoint, cayley, roll_pitch_yaw, rotation_of, transform
from kinematics.urdf import read_urdf, write_urdf

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "COLUMNS",
    "FRAME_COLUMNS",
    "ROW_COLUMNS",
    "CalibratedChain",
    "angle_table",
    "calibrated_chain",
    "dh_table",
    "postures",
    "read_dh",
    "sensitivity",
    "table_text",
    "urdf_text",
]

ROW_COLUMNS = ("theta_offset_rad", "d_m", "a_m", "alpha_rad", "beta_rad")
FRAME_COLUMNS = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
SAID = ("temperature_C", "difference_m")
COLUMNS = ("row", "sign", *(f"{s}{c}" for c in (*ROW_COLUMNS, *FRAME_COLUMNS) for s in ("", "std_")), *SAID)
"""Columns of the table; a column that does not belong to a row is empty there."""

REFERENCE = 20.0  # °C, at which links have the length of the geometry
EXPANSION = "thermal_expansion"
ANGLES = np.deg2rad(5.0)  # between rows of a table of angle errors
POSTURES = 200
STEP = 1e-7  # m or rad: far below every calibrated number, far above rounding
EXACT = 1e-9  # m and rad: what an export may differ from the model, read back
STANDARD = 1e-6  # the same for standard rows, whose long offsets cancel; beyond it they are refused
_AXES = ("rx", "ry", "rz", "x", "y", "z")


@dataclass(frozen=True)
class CalibratedChain:
    """The robot as it is: a product of exponentials.

    Attributes
    ----------
    base
        ``(4, 4)``: the base in the instrument's frame.
    screws
        ``(n, 6)``: (omega, v) in the base frame at the zero pose.
    home
        ``(4, 4)``: the flange at the zero pose, in the base frame.
    """

    robot: RobotDescription
    base: Array
    screws: Array
    home: Array

    def flange(self, q: Array) -> Array:
        """Poses ``(..., 4, 4)`` of the flange in the instrument's frame at joint values ``(..., n)``."""
        return np.asarray(self.base @ forward(self.screws, self.home, q))


def calibrated_chain(
    model: Model,
    *,
    session: int = 0,
    robot: RobotDescription | None = None,
    theta: Array | None = None,
    temperature: float = REFERENCE,
) -> CalibratedChain:
    """The static geometry of a model at one temperature of all links.

    Parameters
    ----------
    session
        Whose base and flange, from 0.
    robot
        The nominal robot, if the model's name for it is not that of a bundled one.
    theta
        Other values for the slots of the stage ``poses``.
    temperature
        °C; another than 20 needs expansion to have been identified.

    Raises
    ------
    ModelError
        The model has no geometry from a table of poses, no such session, or no expansion for another temperature.
    """
    stage = model.stages.get("poses")
    if stage is None or not any(slot.effect == "geometry" for slot in stage.slots):
        raise ModelError("expected a model with geometry identified from a table of poses, found none to export")
    if not 0 <= session < len(model.sessions):
        raise ModelError(f"session {session + 1}: the model has sessions 1 to {len(model.sessions)}")
    reference = model.sessions[session].base_reference
    if reference is None:
        raise ModelError(f"session {session + 1} has no table of poses; its base is not known")
    if temperature != REFERENCE and not any(slot.effect == EXPANSION for slot in stage.slots):
        raise ModelError(
            f"temperature {temperature:g} degC: expected a model with {EXPANSION} in poses, found none; its geometry "
            f"is that of the temperatures of its poses, exported as {REFERENCE:g} degC"
        )
    nominal = load_robot(model.robot) if robot is None else robot
    values = dict(zip(stage.slots, stage.theta if theta is None else theta, strict=True))
    here = model.layout.sessions[session]

    def twist(prefix: str, place: str) -> Array:
        return np.array([values.get(Slot("geometry", prefix + axis, place), 0.0) for axis in _AXES])

    vectors = link_vectors(nominal)
    base = np.asarray(reference) @ _motion(twist("base_", here), np.zeros(3))
    moved, screws = np.eye(4), np.empty((nominal.n, 6))
    for i, pivot in enumerate(link_points(nominal)):
        screws[i] = adjoint(moved) @ nominal.screws[i]
        far_end = twist("", f"link{i + 1}")
        alpha = values.get(Slot(EXPANSION, "alpha", f"link{i + 1}"), 0.0)
        far_end[3:] += alpha * (temperature - REFERENCE) * vectors[i]
        if i + 1 == nominal.n:
            far_end = far_end + twist("flange_", here)
        moved = moved @ _motion(far_end, pivot)
    return CalibratedChain(nominal, base, screws, moved @ nominal.flange)


def _motion(twist: Array, pivot: Array) -> Array:
    """The small motion x -> pivot + v + C(w)(x - pivot), C Cayley's rotation, as in :mod:`clampid.stages.poses`."""
    C = cayley(twist[:3])
    return transform(C, pivot + twist[3:] - C @ pivot)


def sensitivity(
    model: Model,
    numbers: Callable[[CalibratedChain], Array],
    *,
    session: int = 0,
    robot: RobotDescription | None = None,
    temperature: float = REFERENCE,
    difference: Callable[[Array, Array], Array] = np.subtract,
) -> tuple[Array, Array]:
    """How numbers of the calibrated chain follow the parameters of the geometry, by central differences.

    Parameters
    ----------
    numbers
        Gives the numbers ``(M,)`` of a chain, SI.
    session, robot, temperature
        See `calibrated_chain`.
    difference
        Of two results of ``numbers``, where that is more than a subtraction.

    Returns
    -------
    tuple of Array
        Derivatives ``(M, P)`` by the P parameters of ``geometry`` (at another temperature than 20 °C also of the
        expansion), and these parameters' covariance ``(P, P)``.
    """
    stage = model.stages["poses"]
    warm = (EXPANSION,) if temperature != REFERENCE else ()
    free = [k for k, slot in enumerate(stage.slots) if slot.effect in ("geometry", *warm)]
    columns = []
    for k in free:
        step = STEP * np.eye(len(stage.slots))[k]
        sides = [
            numbers(calibrated_chain(model, session=session, robot=robot, theta=theta, temperature=temperature))
            for theta in (stage.theta + step, stage.theta - step)
        ]
        columns.append(difference(sides[0], sides[1]) / (2 * STEP))
    return np.array(columns).T, stage.covariance[np.ix_(free, free)]


def dh_table(
    model: Model,
    convention: Convention,
    *,
    session: int = 0,
    robot: RobotDescription | None = None,
    temperature: float = REFERENCE,
) -> pd.DataFrame:
    """The compensated Denavit–Hartenberg table with standard errors.

    Rows ``1`` … ``n`` have A_i = Rz(sign q_i + theta_offset) Tz(d) Tx(a) Rx(alpha) Ry(beta); rows ``base`` and ``tool``
    a position and a rotation Rz Ry Rx; base A_1 … A_n tool is the flange in the instrument's frame. Column
    ``difference_m`` says by how much the table, read back, differs at most from the model over the joints' ranges.

    Parameters
    ----------
    convention
        ``hayati`` is exact; ``standard`` loses digits between nearly parallel axes.
    session
        Whose base and flange, from 0.
    robot
        The nominal robot, if the model's name for it is not that of a bundled one.
    temperature
        Of all links, °C; see `calibrated_chain`.

    Raises
    ------
    ModelError
        The model has no geometry, or no expansion for that temperature.
    DHError
        Standard rows would lose more than a micrometre, or a joint is helical.
    """
    nominal = load_robot(model.robot) if robot is None else robot
    chain = calibrated_chain(model, session=session, robot=nominal, temperature=temperature)
    numbers, signs = _numbers(chain, convention)

    def moved(chain: CalibratedChain) -> Array:
        return _numbers(chain, convention)[0]

    def apart(a: Array, b: Array) -> Array:
        return _difference(a, b, nominal.n)

    J, covariance = sensitivity(model, moved, session=session, robot=nominal, temperature=temperature, difference=apart)
    std = np.sqrt(np.maximum(np.einsum("ik,kl,il->i", J, covariance, J), 0.0))
    frame = _frame(numbers, std, signs)
    difference = _verify(frame, chain, STANDARD if convention == "standard" else EXACT)
    frame["temperature_C"], frame["difference_m"] = temperature, difference
    return frame


def table_text(frame: pd.DataFrame) -> str:
    """The table as CSV with every digit: standard rows need them."""
    return str(frame.to_csv(index=False, lineterminator="\n"))


def read_dh(text: str, convention: Convention = "hayati") -> DHTable:
    """A table as :func:`table_text` wrote it, to the last digit."""
    records = {record["row"]: record for record in csv.DictReader(io.StringIO(text))}

    def numbers(row: str, columns: Sequence[str]) -> list[float]:
        return [float(records[row][column]) for column in columns]

    rows = []
    for i in range(1, len(records) - 1):
        sign, theta_offset, d, a, alpha, beta = numbers(str(i), ("sign", *ROW_COLUMNS))
        rows.append(DHRow(int(sign), theta_offset, d, a, alpha, beta))
    base, tool = (_pose(np.array(numbers(end, FRAME_COLUMNS))) for end in ("base", "tool"))
    return DHTable(tuple(rows), base, tool, convention)


def _numbers(chain: CalibratedChain, convention: Convention) -> tuple[Array, list[int]]:
    """All numbers of the table, flat: five per row, then six each for base and tool; and the signs."""
    convert = hayati_from_poe if convention == "hayati" else standard_from_poe
    table = convert(chain.screws, chain.home, chain.robot.dh)
    if any(row.prismatic for row in table.rows):
        raise DHError("a prismatic joint adds its value to d, which the exported columns cannot say; export URDF")
    rows = [(r.theta_offset, r.d, r.a, r.alpha, r.beta) for r in table.rows]
    ends = (_position_and_angles(chain.base @ table.base), _position_and_angles(table.tool))
    return np.concatenate([np.ravel(rows), *ends]), [row.sign for row in table.rows]


def _position_and_angles(T: Array) -> Array:
    """Position and (rx, ry, rz) of a pose, R = Rz Ry Rx."""
    return np.concatenate([T[:3, 3], roll_pitch_yaw(T[:3, :3])])


def _pose(numbers: Array) -> Array:
    return transform(rotation_of(numbers[3:]), numbers[:3])


def _difference(a: Array, b: Array, n: int) -> Array:
    """A − b, with angles across ±180° taken the short way."""
    angle = np.array([*[True, False, False, True, True] * n, *[False] * 3, *[True] * 3, *[False] * 3, *[True] * 3])
    d = a - b
    return np.asarray(np.where(angle, np.pi - np.remainder(np.pi - d, 2 * np.pi), d))


def _frame(numbers: Array, std: Array, signs: list[int]) -> pd.DataFrame:
    import pandas as pd

    n = len(signs)
    records: list[dict[str, object]] = []
    for i, sign in enumerate(signs):
        part = slice(5 * i, 5 * i + 5)
        records.append({"row": str(i + 1), "sign": sign, **_named(ROW_COLUMNS, numbers[part], std[part])})
    for k, end in enumerate(("base", "tool")):
        part = slice(5 * n + 6 * k, 5 * n + 6 * k + 6)
        records.append({"row": end, **_named(FRAME_COLUMNS, numbers[part], std[part])})
    frame = pd.DataFrame(records, columns=[name for name in COLUMNS if name not in SAID])
    return frame.astype({"sign": "Int64"})


def _named(columns: tuple[str, ...], numbers: Array, std: Array) -> dict[str, object]:
    out: dict[str, object] = {}
    for column, number, error in zip(columns, numbers.tolist(), std.tolist(), strict=True):
        out |= {column: number, f"std_{column}": error}
    return out


def _ranges(robot: RobotDescription) -> tuple[Array, Array]:
    """Lowest and highest joint values ``(n,)``; half a turn either way where a joint has no limits."""
    return (
        np.where(np.isfinite(robot.lower), robot.lower, -np.pi),
        np.where(np.isfinite(robot.upper), robot.upper, np.pi),
    )


def postures(robot: RobotDescription, count: int = POSTURES, seed: int = 0) -> Array:
    """Joint values ``(count, n)`` drawn over the whole ranges, rad or m: where an export is held against the model."""
    return np.random.default_rng(seed).uniform(*_ranges(robot), (count, robot.n))


def _verify(frame: pd.DataFrame, chain: CalibratedChain, allowed: float) -> float:
    """Read the table back and hold it against the chain: by how much they differ at most, m."""
    q = postures(chain.robot)
    difference = float(np.abs(dh_forward(read_dh(table_text(frame)), q) - chain.flange(q)).max())
    if not difference <= allowed:
        raise DHError(f"the table, read back, differs by {difference:.2g} m from the model, more than {allowed:g} m")
    return difference


def angle_table(
    model: Model, *, robot: RobotDescription | None = None, effects_from: Path | None = None
) -> pd.DataFrame:
    """Errors of joint angles over their ranges, which no table of constant numbers can hold.

    Returns
    -------
    pandas.DataFrame
        ``joint``, ``q_rad`` as the controller reports it, ``error_rad`` (arm less controller: add it before a table of
        Denavit–Hartenberg parameters is used), ``std_error_rad``, and ``extrapolated``, 1 where no pose was near.

    Raises
    ------
    ModelError
        The model has no such errors.
    """
    import pandas as pd

    nominal = load_robot(model.robot) if robot is None else robot
    stage = model.stages.get("poses")
    if stage is None:
        raise ModelError("expected a model with a stage poses, found none")
    parts = []
    known = with_user_effects(effects_from)
    for j, (low, high) in enumerate(zip(*_ranges(nominal), strict=True)):
        q = np.zeros((round((high - low) / ANGLES) + 1, nominal.n))
        q[:, j] = np.linspace(low, high, len(q))
        found = angle_errors(stage, known, model.layout, nominal, q)
        if found.active[j]:
            columns = {
                "q_rad": q,
                "error_rad": found.error,
                "std_error_rad": found.std,
                "extrapolated": found.extrapolated,
            }
            part = pd.DataFrame({name: values[:, j] for name, values in columns.items()})
            part.insert(0, "joint", j + 1)
            parts.append(part.astype({"extrapolated": int}))
    if not parts:
        raise ModelError("expected a model with errors of joint angles (such as gear_eccentricity), found none")
    return pd.concat(parts, ignore_index=True)


def urdf_text(
    model: Model, *, session: int = 0, robot: RobotDescription | None = None, temperature: float = REFERENCE
) -> str:
    """The calibrated chain as URDF; its frame ``world`` is the instrument's.

    The file says its temperature and by how much it, read back, differs at most from the model over the joints' ranges.

    Raises
    ------
    ModelError
        The model has no geometry, or the file, read back, is not the model.
    DescriptionError
        A joint is neither revolute nor prismatic.
    """
    import tempfile

    chain = calibrated_chain(model, session=session, robot=robot, temperature=temperature)
    text = write_urdf(chain.screws, chain.home, chain.robot, chain.base)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        write_text(path, text)
        back = read_urdf(path, "flange")
    q = postures(chain.robot)
    difference = float(np.abs(forward(back.screws, back.flange, q) - chain.flange(q)).max())
    if not difference <= EXACT:
        raise ModelError(f"the URDF, read back, differs by {difference:.2g} m from the model, more than {EXACT:g} m")
    head, _, rest = text.partition("\n")
    said = (
        f"<!-- clampid: static geometry at {temperature:g} degC; read back it differs by at most {difference:.1e} m "
        f"from the model, over {POSTURES} postures in the joints' ranges -->"
    )
    return f"{head}\n{said}\n{rest}"
