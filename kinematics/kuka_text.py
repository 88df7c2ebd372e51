"""
Machine data as text, in the lines of a controller's `$machine.dat`: millimetres and degrees.

What is written is a part of that file, to be put into it by hand. Mastering is written as what to add to $MAMES, in a
remark, because its value is each machine's own. What is read may be a whole `$machine.dat`.
"""

import re
from collections.abc import Iterable, Mapping

import numpy as np

from kinematics.escaping import for_krl
from kinematics.kuka import AXES, Hand, MachineData, MachineDataError
from kinematics.typing_ import Array

__all__ = ["machine_data_text", "read_machine_data"]

_FRAMES = {"robroot": "$ROBROOT", "tiroro": "$TIRORO", "tflwp": "$TFLWP", "tx3p3": "$TX3P3"}
_LENGTHS = {"length_a": "$LENGTH_A", "length_b": "$LENGTH_B"}
_TO_MM_DEG = np.array([1e3, 1e3, 1e3, *np.degrees([1.0, 1.0, 1.0])])
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_REMARK = "; to $MAMES"


def machine_data_text(data: MachineData, std: Mapping[str, Array], said: Iterable[str] = ()) -> str:
    """
    Write machine data.

    Parameters
    ----------
    data
        What to write.
    std
        Standard errors by attribute of `MachineData`, in its units and shapes; nan where a number is not a result.
    said
        Lines to go before it, as remarks.

    Returns
    -------
    str
        Lines in the form of a `$machine.dat`; ASCII. Source: KUKA2005.
    """
    lines = [f"; {for_krl(line)}".rstrip() for line in said]
    for name, variable in _FRAMES.items():
        numbers = getattr(data, name) * _TO_MM_DEG
        given = ",".join(f"{c} {_fixed(v)}" for c, v in zip("XYZABC", numbers, strict=True))
        errors = std.get(name)
        lines.append(f"FRAME {variable}={{{given}}}{_errors('XYZABC', errors, _TO_MM_DEG)}")
    for name, variable in _LENGTHS.items():
        errors = std.get(name)
        lines.append(f"REAL {variable}={_fixed(1e3 * getattr(data, name))}{_errors(' ', errors, _TO_MM_DEG[:1])}")
    for name, hand in (("$DH_4", data.dh_4), ("$DH_5", data.dh_5)):
        alpha = _fixed(np.degrees(hand.alpha))
        given = f"DHART_A {_fixed(1e3 * hand.a)},DHART_D {_fixed(1e3 * hand.d)},DHART_ALPHA {alpha}"
        lines.append(f"DECL DHART {name}={{{given}}}")
    lines += [f"$AXIS_DIR[{i + 1}]={sign}" for i, sign in enumerate(data.axis_dir)]
    for i, (offset, error) in enumerate(zip(data.mastering, std.get("mastering", np.full(AXES, np.nan)), strict=True)):
        lines.append(f"{_REMARK}[{i + 1}] add {_fixed(np.degrees(offset))}{_errors(' ', [error], _TO_MM_DEG[3:4])}")
    return "\n".join(lines) + "\n"


def read_machine_data(text: str) -> MachineData:
    """
    Read machine data: a whole `$machine.dat` or what `machine_data_text` wrote.

    Parameters
    ----------
    text
        The file's text.

    Returns
    -------
    MachineData
        What it says; mastering 0 where it does not say what to add.

    Raises
    ------
    MachineDataError
        If a variable is missing, given twice or not readable; or if it is no articulated arm.
    """
    kind = re.search(r"\$MAIN_AXIS\s*=\s*(#\w+)", text)
    if kind is not None and kind[1] != "#NR":
        raise MachineDataError(f"$MAIN_AXIS: expected #NR, an articulated arm, found {kind[1]}")
    directions = [
        int(_one(text, rf"^\s*\$AXIS_DIR\[{i + 1}\]\s*=\s*([-+]?1)\b", f"$AXIS_DIR[{i + 1}]")) for i in range(AXES)
    ]
    added = dict(re.findall(rf"^{re.escape(_REMARK)}\[(\d)\] add ({_NUMBER})", text, re.MULTILINE))
    return MachineData(
        robroot=_frame(text, "$ROBROOT"),
        tiroro=_frame(text, "$TIRORO"),
        length_a=_length(text, "$LENGTH_A"),
        length_b=_length(text, "$LENGTH_B"),
        tx3p3=_frame(text, "$TX3P3"),
        dh_4=_hand(text, "$DH_4"),
        dh_5=_hand(text, "$DH_5"),
        tflwp=_frame(text, "$TFLWP"),
        axis_dir=tuple(directions),
        mastering=np.radians([float(added.get(str(i + 1), 0.0)) for i in range(AXES)]),
    )


def _fixed(value: float) -> str:
    """A nanometre, or a nanodegree, is the last digit; no minus before zero."""
    return f"{round(float(value), 9) + 0.0:.9f}"


def _errors(names: str, errors: Iterable[float] | None, scale: Array) -> str:
    """Standard errors as a remark behind the line, in the units of the line."""
    scaled = np.full(len(names), np.nan) if errors is None else np.asarray(errors) * scale
    listed = [f"{name} {error:.2g}".strip() for name, error in zip(names, scaled, strict=True) if np.isfinite(error)]
    return f" ; std {', '.join(listed)}" if listed else ""


def _one(text: str, pattern: str, variable: str) -> str:
    found = re.findall(pattern, text, re.MULTILINE)
    if len(found) != 1:
        raise MachineDataError(
            f"{variable}: expected it once, with numbers in KUKA's form, found it {len(found)} times"
        )
    return str(found[0])


def _structure(text: str, variable: str, fields: tuple[str, ...]) -> list[float]:
    inside = _one(text, rf"^[^;\n]*{re.escape(variable)}\s*=\s*\{{([^}}]*)\}}", variable)
    parts = dict(re.findall(rf"\b(\w+)\s+({_NUMBER})", inside))
    if tuple(parts) != fields:
        raise MachineDataError(f"{variable}: expected {', '.join(fields)}, found {', '.join(parts) or 'nothing'}")
    return [float(parts[field]) for field in fields]


def _frame(text: str, variable: str) -> Array:
    return np.asarray(np.array(_structure(text, variable, tuple("XYZABC"))) / _TO_MM_DEG)


def _hand(text: str, variable: str) -> Hand:
    a, d, alpha = _structure(text, variable, ("DHART_A", "DHART_D", "DHART_ALPHA"))
    return Hand(a / 1e3, d / 1e3, float(np.radians(alpha)))


def _length(text: str, variable: str) -> float:
    return float(_one(text, rf"^[^;\n]*{re.escape(variable)}\s*=\s*({_NUMBER})", variable)) / 1e3
