"""Reads a table of reflections: the robot's posture, the peak's place on the detector, and its reflection."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.columns import Column, TableFormat, joint_columns, lookalike
from experiments.errors import fault
from experiments.tables import TableFile, read_table
from experiments.validate import typed_columns
from offline_ik.errors import TargetError
from offline_ik.reflections.bragg import scattering_angle
from offline_ik.reflections.peaks import Peak

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["HC", "read_peaks", "wavelength_of"]

HC = 12.398419843320026  # keV angstrom, exact: Planck's constant times the speed of light, SI of 2019
SHORTEST, LONGEST = 0.01, 100.0  # angstrom, of X-rays that a crystal reflects
WEAKEST, HARDEST = HC / LONGEST, HC / SHORTEST  # keV
LARGEST_SPACING = 1e4  # angstrom


def wavelength_of(energy: float | None = None, wavelength: float | None = None) -> float | None:
    """The wavelength in angstrom, of the photons' energy in keV or as it is; None where neither is given.

    Raises
    ------
    TargetError
        Both are, or one that cannot be meant (eV, metres).
    """
    if energy is not None and wavelength is not None:
        raise TargetError("expected an energy or a wavelength, found both")
    if energy is not None:
        if not WEAKEST <= energy <= HARDEST:
            hint = f"; did you mean {energy:g} eV, that is {energy / 1000:g} keV?" if energy > HARDEST else ""
            raise TargetError(f"energy: expected keV from {WEAKEST:.2g} to {HARDEST:.4g}, found {energy:g}{hint}")
        return HC / energy
    if wavelength is not None and not SHORTEST <= wavelength <= LONGEST:
        hint = f"; did you mean {wavelength:g} m, that is {wavelength * 1e10:g}?" if 0 < wavelength < 1e-7 else ""
        raise TargetError(f"wavelength: expected angstrom from {SHORTEST:g} to {LONGEST:g}, found {wavelength:g}{hint}")
    return wavelength


def read_peaks(path: str | Path, joints: int, pixel: float, wavelength: float | None = None) -> tuple[Peak, ...]:
    """Read a table of reflections, one a row.

    Parameters
    ----------
    joints
        How many the robot has.
    pixel
        Edge of a pixel, m.
    wavelength
        Angstrom; for tables of spacings.

    Raises
    ------
    CampaignError
        The file is none, has no such columns or unknown ones, or a cell that cannot be meant: row and column are named.
    TargetError
        The table has spacings and there is no wavelength, or the other way round.
    """
    path = Path(path)
    if not path.exists():
        raise fault(path, expected="a table of reflections", found="no such file")
    frame, source = read_table(path), TableFile(path)
    names = [str(name) for name in frame.columns]
    by_joints, by_spacing = _by_joints(names, source), _by_spacing(names, source)
    table = _format(joints, by_joints, by_spacing)
    frame = typed_columns(frame, table, source)
    _refuse_unknown(names, table, source)
    _refuse_repeated(frame, source)
    if by_spacing and wavelength is None:
        raise TargetError(f"{path}: spacings need the energy or the wavelength: expected one, found none")
    if not by_spacing and wavelength is not None:
        raise TargetError(f"{path}: expected no energy or wavelength with two_theta_rad: the angles are there")
    angles = [_angle(row, frame, source, wavelength) for row in range(len(frame))]
    at = joint_columns("q{}_rad", joints) if by_joints else ("gamma_rad", "delta_rad", "r_m")
    places = frame[list(at)].to_numpy(dtype=float)
    if not by_joints:
        places = np.column_stack([places, _column(frame, "roll_rad")])
    directions = joint_columns("dir{}", joints)
    given = frame[list(directions)].to_numpy(dtype=float) if directions[0] in frame else np.zeros((len(frame), joints))
    offsets = np.column_stack([_length(frame, axis, pixel) for axis in ("x", "y")])
    std = _length(frame, "std", pixel)
    return tuple(
        Peak(
            angles[k],
            float(frame["std_two_theta_rad"].iloc[k]),
            places[k] if by_joints else None,
            None if by_joints else places[k].tolist(),
            given[k],
            offsets[k].tolist(),
            float(std[k]),
            str(frame["name"].iloc[k]) if "name" in frame else "",
        )
        for k in range(len(frame))
    )


def _format(joints: int, by_joints: bool, by_spacing: bool) -> TableFormat:
    places = joint_columns("q{}_rad", joints) if by_joints else ("gamma_rad", "delta_rad", "r_m")
    angle = "spacing_angstrom" if by_spacing else "two_theta_rad"
    directions = tuple(Column(name, "integer", lower=-1, upper=1) for name in joint_columns("dir{}", joints))
    required = (*map(Column, places), Column(angle), Column("std_two_theta_rad"))
    optional: list[tuple[Column, ...]] = [directions, (Column("name", "text"),)]
    for unit in ("m", "pixels"):
        optional += [(Column(f"x_{unit}"), Column(f"y_{unit}")), (Column(f"std_{unit}", lower=0.0),)]
    if not by_joints:
        optional.append((Column("roll_rad"),))
    return TableFormat("reflections", required, tuple(optional), run=None)


def _by_joints(names: Sequence[str], source: TableFile) -> bool:
    """Whether the table says where the robot stood by joint angles; by gamma, delta and r otherwise."""
    joints, sphere = lookalike("q1_rad", names) is not None, lookalike("gamma_rad", names) is not None
    return _one_of(joints, sphere, "columns q1_rad … or gamma_rad, delta_rad, r_m", source)


def _by_spacing(names: Sequence[str], source: TableFile) -> bool:
    spacing = any(name.lower().startswith("spacing") for name in names)
    angle = lookalike("two_theta_rad", [name for name in names if not name.startswith("std")]) is not None
    return _one_of(spacing, angle, "a column two_theta_rad or spacing_angstrom", source)


def _one_of(first: bool, second: bool, expected: str, source: TableFile) -> bool:
    if first == second:
        raise source.fault(expected=expected, found="both" if first else "neither")
    return first


def _refuse_unknown(names: Sequence[str], table: TableFormat, source: TableFile) -> None:
    """A misnamed optional column must not be left out in silence."""
    for name in names:
        if name not in table.known():
            raise source.fault(expected=f"columns of {', '.join(table.known())}", found="another one", column=name)
    for first, second in (("x_m", "x_pixels"), ("std_m", "std_pixels")):
        if first in names and second in names:
            raise source.fault(expected=f"{first} or {second}", found="both")


def _refuse_repeated(frame: pd.DataFrame, source: TableFile) -> None:
    for row in np.flatnonzero(frame.duplicated().to_numpy()).tolist():
        same = int(np.flatnonzero((frame == frame.iloc[row]).all(axis=1).to_numpy())[0])
        raise source.fault(expected="every reflection once", found=f"row {source.number(same)} again", row=row)


def _angle(row: int, frame: pd.DataFrame, source: TableFile, wavelength: float | None) -> float:
    if wavelength is None:
        value = float(frame["two_theta_rad"].iloc[row])
        if not 0 < value < math.pi:
            hint = f"; did you mean {value:g} degrees, that is {math.radians(value):.6g}?" if 0 < value <= 180 else ""
            raise source.fault(
                expected="radians between 0 and pi", found=f"{value:g}{hint}", row=row, column="two_theta_rad"
            )
        return value
    spacing = float(frame["spacing_angstrom"].iloc[row])
    if not 0 < spacing <= LARGEST_SPACING:
        expected = f"a positive spacing of at most {LARGEST_SPACING:g} angstrom"
        raise source.fault(expected=expected, found=f"{spacing:g}", row=row, column="spacing_angstrom")
    if spacing <= 0.5 * wavelength:
        raise source.fault(
            expected=f"a spacing above half the wavelength, {0.5 * wavelength:.6g} angstrom: none smaller reflects it",
            found=f"{spacing:g}", row=row, column="spacing_angstrom",
        )  # fmt: skip
    return scattering_angle(wavelength, spacing)


def _length(frame: pd.DataFrame, name: str, pixel: float) -> Any:
    """``(N,)``, m: of a column in metres or in pixels; zeros where there is neither."""
    return _column(frame, f"{name}_m") + pixel * _column(frame, f"{name}_pixels")


def _column(frame: pd.DataFrame, name: str) -> Any:
    return frame[name].to_numpy(dtype=float) if name in frame else np.zeros(len(frame))
