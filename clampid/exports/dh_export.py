"""The compensated robot as Denavit–Hartenberg tables with uncertainties.

They hold the calibrated chain (:mod:`clampid.models.calibrated`): what is static at one temperature of all links, 20 °C
unless another is stated. Effects that depend on posture, load or direction are no part of them (errors of joint angles
have a table of their own); what that leaves of the whole model is measured over the workspace and written into the
file.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from clampid.exports.best_table import BestTable, best_table
from clampid.exports.determined import fix_undetermined
from clampid.exports.exported import EXACT, Exported, checked
from clampid.exports.form_error import postures
from clampid.models.calibrated import CalibratedChain, calibrated_chain, sensitivity
from clampid.models.described import robot_of
from clampid.models.model import Model
from clampid.stages.rows import Array
from experiments.campaign import Campaign
from experiments.temperatures import REFERENCE_TEMPERATURE
from kinematics.dh import Convention, DHRow, DHTable
from kinematics.dh import forward as dh_forward
from kinematics.dh_conversion import DHError, hayati_from_poe, standard_from_poe
from kinematics.escaping import for_csv
from kinematics.fixed_angles import roll_pitch_yaw, rotation_of
from kinematics.robot import RobotDescription
from kinematics.screws import transform

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "COLUMNS",
    "FRAME_COLUMNS",
    "ROW_COLUMNS",
    "CalibratedChain",
    "ExportedTable",
    "calibrated_chain",
    "dh_export",
    "dh_table",
    "nominal_rows",
    "postures",
    "read_dh",
    "sensitivity",
    "static_table",
    "table_text",
]

ROW_COLUMNS = ("theta_offset_rad", "d_m", "a_m", "alpha_rad", "beta_rad")
FRAME_COLUMNS = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
SAID = ("temperature_C", "difference_m")
NOT_DETERMINED = "not_determined"
LEFT = (*(f"left_by_table_{k}_{unit}" for unit in ("m", "rad") for k in ("rms", "max")), "not_in_table")
COLUMNS = (
    "row",
    "sign",
    *(f"{s}{c}" for c in (*ROW_COLUMNS, *FRAME_COLUMNS) for s in ("", "std_")),
    *SAID,
    *LEFT,
    NOT_DETERMINED,
)
"""Columns of the table; a column that does not belong to a row is empty there."""

COLUMN_OF = {f"{name}_{unit}": name for name, unit in (column.rsplit("_", 1) for column in ROW_COLUMNS)}
MOUNT_TURN_RAD = 0.05  # no zero offset of a working arm is larger; a probe is mounted at any angle
ARITHMETIC_ERROR = 1e-10  # of a number, or of 1 m or rad: a standard error below that is arithmetic
NOUGHT = 1e-12  # m and rad: rounding of derivatives
STANDARD = 1e-6  # the same for standard rows, whose long offsets cancel; beyond it they are refused


TableFit = Literal["best", "static"]
"""Which geometry a table has: the one that serves a controller best which knows nothing else, or the model's own."""


def _no_table() -> pd.DataFrame:
    import pandas as pd

    return pd.DataFrame(columns=list(COLUMNS))


@dataclass(frozen=True, eq=False)
class ExportedTable(Exported):
    """A Denavit–Hartenberg table as a file, CSV, and as a frame with the columns :data:`COLUMNS`.

    Attributes
    ----------
    fit
        How its geometry was fitted to the whole model; None where it is the model's own.
    nominal
        The nominal robot's rows in the same convention, for comparison.
    """

    convention: Convention = "hayati"
    table: pd.DataFrame = field(default_factory=_no_table)
    fit: BestTable | None = None
    nominal: tuple[DHRow, ...] = ()

    @property
    def said(self) -> tuple[str, ...]:
        """What it leaves, in sentences."""
        return super().said if self.fit is None else (str(self.fit), *super().said)

    @property
    def cautions(self) -> tuple[str, ...]:
        """As of any export; which numbers depend on a choice, and how a measured frame is mounted."""
        if not self.fixed:
            return self._mount()
        found = [
            f"{'row ' if row['row'].isdigit() else ''}{row['row']}: "
            + ", ".join(
                self._beside_nominal(str(row["row"]), column, row[column]) for column in row[NOT_DETERMINED].split()
            )
            for _, row in self.table.iterrows()
            if row[NOT_DETERMINED]
        ]
        unsure = f"part of it, not determined by themselves and without standard error: {'; '.join(found)}"
        return (*super().cautions, unsure, *self._mount())

    def _beside_nominal(self, row: str, column: str, value: float) -> str:
        """``d_m 0.0913 (nominal 0.0922)``; base and tool have no nominal place."""
        if not row.isdigit() or not self.nominal:
            return column
        return f"{column} {value:.4f} (nominal {getattr(self.nominal[int(row) - 1], COLUMN_OF[column]):.4f})"

    def _mount(self) -> tuple[str, ...]:
        """That the last row holds how a measured frame is mounted, where it is turned by more than any arm's error."""
        if not self.nominal:
            return ()
        last = self.table[self.table["row"] == str(len(self.nominal))].iloc[0]
        here, nominal = float(last["theta_offset_rad"]), self.nominal[-1].theta_offset
        turned = float(np.remainder(here - nominal + np.pi, 2.0 * np.pi) - np.pi)
        if abs(turned) < MOUNT_TURN_RAD:
            return ()
        return (
            f"the measured frame is mounted at {np.degrees(turned):.1f} deg on the flange: row {last['row']} and the "
            "row tool lead to that frame, not to the nominal flange",
        )

    def to_json(self) -> dict[str, Any]:
        """As of any export, and the table row by row."""
        rows = (row.dropna() for _, row in self.table.drop(columns=[*SAID, *LEFT]).iterrows())
        fit = None if self.fit is None else {"static_rms_m": self.fit.static.position_rms,
                                             "rms_m": self.fit.best.position_rms, "at": self.fit.where}  # fmt: skip
        return {"convention": self.convention, "fit": fit, **super().to_json(), "rows": [row.to_dict() for row in rows]}


def dh_export(
    model: Model,
    convention: Convention,
    *,
    fit: TableFit = "best",
    session: int = 0,
    robot: RobotDescription | None = None,
    temperature: float = REFERENCE_TEMPERATURE,
    campaign: Campaign | None = None,
    user_effects: Path | None = None,
) -> ExportedTable:
    """The compensated Denavit–Hartenberg table with standard errors, and what it leaves of the whole model.

    Rows ``1`` … ``n`` have A_i = Rz(sign q_i + theta_offset) Tz(d) Tx(a) Rx(alpha) Ry(beta); rows ``base`` and ``tool``
    a position and a rotation Rz Ry Rx; base A_1 … A_n tool is the flange in the instrument's frame. Where a linkage
    couples joints, q are the joint values of the chain and not the controller's. Column ``difference_m`` says by how
    much the table, read back, differs at most from its chain over the joints' ranges; ``left_by_table_…`` how far the
    flange of the whole model is from it there, and ``not_in_table`` by which effects. A combination of
    numbers that the data do not determine has its nominal value; ``not_determined`` names the numbers that are part of
    one. These have no standard error, and may differ from the nominal ones by what the data do determine.

    Parameters
    ----------
    convention
        ``hayati`` is exact; ``standard`` loses digits between nearly parallel axes.
    fit
        ``best``: the geometry with which the table alone comes nearest to the whole model, for a controller that knows
        nothing else (`clampid.exports.best_table`). ``static``: the model's geometry, where something else corrects
        its other effects.
    session
        Whose base and flange, from 0.
    robot
        The nominal robot, if the model's name for it is not that of a bundled one.
    temperature
        Of all links, °C; see `calibrated_chain`.
    campaign
        That of the session: its declared tool loads the model, and on its measured points it is said what the table
        alone leaves.
    user_effects
        The user's own effects; by default the file that the model names.

    Raises
    ------
    ModelError
        The model has no geometry, no expansion for that temperature, or effects that are not known; or the campaign is
        not that of the session.
    DHError
        Standard rows would lose more than a micrometre, or a joint is helical.
    """
    nominal = robot_of(model, robot)
    calibrated_chain(model, session=session, robot=nominal, temperature=temperature)  # refuses what has no table
    fixed = fix_undetermined(model)
    best = None
    if fit == "best":
        best = best_table(
            fixed.model, nominal, session=session, temperature=temperature, campaign=campaign, user_effects=user_effects
        )
    source = fixed.model if best is None else best.model
    frame = static_table(
        source, convention, session=session, robot=nominal, temperature=temperature, spread=fixed.spread
    )
    table = read_dh(table_text(frame))
    left, measured = checked(
        lambda q: dh_forward(table, q), fixed.model, nominal, session, temperature, campaign, user_effects
    )
    e = left.error
    frame[list(LEFT[:-1])] = e.position_rms, e.position_max, e.orientation_rms, e.orientation_max
    frame[LEFT[-1]] = " ".join(left.effects)
    frame[NOT_DETERMINED] = frame.pop(NOT_DETERMINED)  # the last column
    difference = float(frame["difference_m"].iloc[0])
    text, rows = table_text(frame), nominal_rows(nominal, convention)
    combined = fixed.combinations
    return ExportedTable(text, temperature, difference, left, measured, combined, convention, frame, best, rows)


def dh_table(model: Model, convention: Convention, **options: Any) -> pd.DataFrame:
    """The table of :func:`dh_export`, which says the ``options``, as a frame with the columns :data:`COLUMNS`."""
    return dh_export(model, convention, **options).table


def static_table(
    model: Model,
    convention: Convention,
    *,
    session: int = 0,
    robot: RobotDescription | None = None,
    temperature: float = REFERENCE_TEMPERATURE,
    spread: Array | None = None,
) -> pd.DataFrame:
    """The compensated table as :func:`dh_export` has it, without what it leaves of the whole model.

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
    spread
        ``(G, k)``: what of the geometry is fixed because the data do not determine it, see
        :class:`clampid.exports.determined.Determined`; None: it is found here, and fixed.

    Raises
    ------
    ModelError
        The model has no geometry, or no expansion for that temperature.
    DHError
        Standard rows would lose more than a micrometre, or a joint is helical.
    """
    nominal = robot_of(model, robot)
    if spread is None:
        fixed = fix_undetermined(model)
        model, spread = fixed.model, fixed.spread
    chain = calibrated_chain(model, session=session, robot=nominal, temperature=temperature)
    numbers, signs = _numbers(chain, convention)

    def moved(chain: CalibratedChain) -> Array:
        return _numbers(chain, convention)[0]

    def apart(a: Array, b: Array) -> Array:
        return _difference(a, b, nominal.n)

    J, covariance = sensitivity(model, moved, session=session, robot=nominal, temperature=temperature, difference=apart)
    std = np.sqrt(np.maximum(np.einsum("ik,kl,il->i", J, covariance, J), 0.0))
    # Of a number that goes with what is fixed the rest of its error says little.
    std[std < ARITHMETIC_ERROR * np.maximum(np.abs(numbers), 1.0)] = (
        0.0  # a constant: what arithmetic leaves is no error
    )
    free = J[:, : len(spread)] @ spread if spread.size else np.zeros((len(std), 1))
    std[np.sqrt(np.sum(free**2, axis=1)) > std + NOUGHT] = np.nan
    frame = _frame(numbers, std, signs)
    difference = _verify(frame, chain, STANDARD if convention == "standard" else EXACT)
    frame["temperature_C"], frame["difference_m"] = temperature, difference
    return frame


def table_text(frame: pd.DataFrame) -> str:
    """The table as CSV with every digit: standard rows need them."""
    texts = frame.select_dtypes(include=["object", "string"]).columns
    safe = frame.assign(**{str(c): [for_csv(v) if isinstance(v, str) else v for v in frame[c]] for c in texts})
    return str(safe.to_csv(index=False, lineterminator="\n"))


def read_dh(text: str, convention: Convention = "hayati") -> DHTable:
    """A table as :func:`table_text` wrote it, to the last digit.

    Raises
    ------
    DHError
        A row, a column or a number is missing.
    """
    try:
        records = {record["row"]: record for record in csv.DictReader(io.StringIO(text))}

        def numbers(row: str, columns: Sequence[str]) -> list[float]:
            found = [float(records[row][column]) for column in columns]
            if not np.isfinite(found).all():
                raise ValueError(f"row {row}: expected finite numbers")
            return found

        rows = []
        for i in range(1, len(records) - 1):
            sign, theta_offset, d, a, alpha, beta = numbers(str(i), ("sign", *ROW_COLUMNS))
            rows.append(DHRow(int(sign), theta_offset, d, a, alpha, beta))
        base, tool = (_pose(np.array(numbers(end, FRAME_COLUMNS))) for end in ("base", "tool"))
    except (KeyError, TypeError, ValueError, OverflowError, csv.Error) as error:
        raise DHError(f"expected a table as it is exported: {type(error).__name__}: {error}") from error
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


def nominal_rows(robot: RobotDescription, convention: Convention) -> tuple[DHRow, ...]:
    """The nominal robot's rows; none where it cannot be written in this convention."""
    convert = hayati_from_poe if convention == "hayati" else standard_from_poe
    try:
        return tuple(convert(robot.screws, robot.flange, robot.dh).rows)
    except DHError:
        return ()


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
    frame = pd.DataFrame(records, columns=[name for name in COLUMNS if name not in (*SAID, *LEFT, NOT_DETERMINED)])
    frame[NOT_DETERMINED] = [_open_columns(row) for row in records]
    return frame.astype({"sign": "Int64"})


def _open_columns(row: Mapping[str, object]) -> str:
    """The columns of a row whose numbers have no standard error, because something in them is fixed."""
    own = FRAME_COLUMNS if row["row"] in ("base", "tool") else ROW_COLUMNS
    return " ".join(column for column in own if row[f"std_{column}"] != row[f"std_{column}"])  # nan


def _named(columns: tuple[str, ...], numbers: Array, std: Array) -> dict[str, object]:
    out: dict[str, object] = {}
    for column, number, error in zip(columns, numbers.tolist(), std.tolist(), strict=True):
        out |= {column: number, f"std_{column}": error}
    return out


def _verify(frame: pd.DataFrame, chain: CalibratedChain, allowed: float) -> float:
    """Read the table back and hold it against the chain: by how much they differ at most, m."""
    q = postures(chain.robot)
    difference = float(np.abs(dh_forward(read_dh(table_text(frame)), q) - chain.flange(q)).max())
    if not difference <= allowed:
        raise DHError(f"the table, read back, differs by {difference:.2g} m from the model, more than {allowed:g} m")
    return difference
