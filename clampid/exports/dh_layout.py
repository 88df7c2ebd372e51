"""The compensated Denavit–Hartenberg table for readers, laid out as the thesis prints its nominal one.

Of the thesis' tables the nominal one is known (``appendix_data/dh_nominal_printed.csv``): a row per link with theta, d,
a and alpha in this order, in rad and m, theta with the joint's sign and offset (``−θ1``, ``θ3 − π/2``), right angles as
parts of π. So are the rows here, the nominal above the compensated. Standard errors, beta, and base and tool are ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd

from clampid.exports.dh_export import FRAME_COLUMNS, ROW_COLUMNS, ExportedTable, read_dh, table_text
from clampid.exports.form_error import POSTURES, postures
from kinematics.dh import DHRow, forward
from kinematics.dh_conversion import hayati_from_poe, standard_from_poe
from kinematics.escaping import for_markdown
from kinematics.robot import RobotDescription

__all__ = ["thesis_layout"]

LEGIBLE = 1e-6  # m and rad: what the digits may cost
MIN_DECIMALS, MAX_DECIMALS = 6, 15  # decimals of m and rad
RIGHT = 1e-12  # rad: how far an angle may be from a multiple of a right one to be written as such
SYMBOLS = {"theta_offset_rad": "θ [rad]", "d_m": "d [m]", "a_m": "a [m]", "alpha_rad": "α [rad]", "beta_rad": "β [rad]"}
FORMULA = "A_i = Rz(θ) Tz(d) Tx(a) Rx(α)"


def thesis_layout(found: ExportedTable, robot: RobotDescription) -> str:
    """The table as Markdown, in rad and m, with as many decimals as it takes to be as good as the CSV to a micrometre.

    Parameters
    ----------
    found
        The compensated table.
    robot
        The nominal robot in the chain of which it stands.

    Returns
    -------
    str
        It says what the digits cost, read back, and what the table leaves of the model.

    Raises
    ------
    DHError
        The nominal robot cannot be written in this convention.
    """
    convert = hayati_from_poe if found.convention == "hayati" else standard_from_poe
    nominal = convert(robot.screws, robot.flange, robot.dh)
    printed = _rounded(found.table, robot)
    columns = [c for c in ROW_COLUMNS if c != "beta_rad" or found.convention == "hayati"]
    n = len(nominal.rows)
    lines = _head(["link", "", *(SYMBOLS[c] for c in columns)])
    for i, row in enumerate(nominal.rows):
        before = [_theta(i, row.sign, _exact(row.theta_offset)), *(_nominal(row, c) for c in columns[1:])]
        after = [printed.cell(i, c) for c in columns]
        after[0] = _theta(i, int(found.table["sign"].iloc[i]), after[0])
        lines += [_line([f"{i + 1}", "nominal", *before]), _line(["", "compensated", *after])]
    lines += ["", *_head(["", *(c.replace("_m", " [m]").replace("_rad", " [rad]") for c in FRAME_COLUMNS)])]
    lines += [_line([end, *(printed.cell(n + k, c) for c in FRAME_COLUMNS)]) for k, end in enumerate(("base", "tool"))]
    formula = FORMULA + (" Ry(β)" if "beta_rad" in columns else "")
    said = [
        f"{for_markdown(robot.title)}: {found.convention} convention, {found.temperature:g} degC; value ± one standard "
        "error.",
        f"{formula}; base A_1 … A_n tool is the flange in the instrument's frame, base and tool rotate by Rz Ry Rx.",
        f"Rounding: read back, the digits above differ by at most {printed.cost:.1e} m from the full table, over "
        f"{POSTURES} postures in the joints' ranges.",
        *(f"{line[0].upper()}{line[1:]}" for line in found.said),
    ]
    return "\n".join([*lines, "", *(f"* {line}" for line in said), ""])


@dataclass(frozen=True, eq=False)
class _Printed:
    """A table rounded to some decimals, and what that costs, m."""

    table: pd.DataFrame
    decimals: int
    cost: float

    def cell(self, row: int, column: str) -> str:
        """``value ± standard error``; the value alone where the convention fixes it."""
        value, std = float(self.table[column].iloc[row]), float(self.table[f"std_{column}"].iloc[row])
        text = f"{value + 0.0:.{self.decimals}f}"
        if not std >= 0.5 * 10.0**-self.decimals:
            return _minus(text)
        places = max(0, 1 - math.floor(math.log10(std)))
        return f"{_minus(text)} ± {std:.{min(places, self.decimals)}f}"


def _rounded(table: pd.DataFrame, robot: RobotDescription) -> _Printed:
    """The table with as few decimals as keep the flange; offsets d of kilometres need many angles' digits."""
    q, exact = postures(robot), read_dh(table_text(table))
    there, numbers = forward(exact, q), [*ROW_COLUMNS, *FRAME_COLUMNS]
    for decimals in range(MIN_DECIMALS, MAX_DECIMALS + 1):
        rounded = table.copy()
        rounded[numbers] = rounded[numbers].round(decimals) + 0.0  # no −0
        cost = float(np.abs(forward(read_dh(table_text(rounded)), q) - there).max())
        if cost <= LEGIBLE:
            break
    return _Printed(rounded, decimals, cost)


def _theta(link: int, sign: int, offset: str) -> str:
    """``−θ1 + 0.000123 ± 0.000004``, or ``θ3 − π/2``."""
    variable = f"{'−' if sign < 0 else ''}θ{link + 1}"
    if offset == "0":
        return variable
    return f"{variable} − {offset[1:]}" if offset.startswith("−") else f"{variable} + {offset}"


def _nominal(row: DHRow, column: str) -> str:
    value = {"d_m": row.d, "a_m": row.a, "alpha_rad": row.alpha, "beta_rad": row.beta}[column]
    return _exact(value) if column.endswith("_rad") else _minus(f"{round(value, 12) + 0.0:.12g}")


def _exact(angle: float) -> str:
    """An angle as a part of π where it is a multiple of a right one, else in rad."""
    quarter = round(angle / (math.pi / 2))
    if abs(angle - quarter * math.pi / 2) > RIGHT:
        return _minus(f"{angle:.12g}")
    known = {0: "0", 1: "π/2", 2: "π", -1: "−π/2", -2: "−π"}
    return known.get(quarter, _minus(f"{quarter}π/2"))


def _minus(text: str) -> str:
    return text.replace("-", "−")


def _head(titles: list[str]) -> list[str]:
    return [_line(titles), _line(["---"] * len(titles))]


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"
