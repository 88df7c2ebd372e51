"""Numbers as people read them: engineering units, and as many digits as the standard error leaves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

__all__ = ["Scale", "count_text", "error_text", "fixed", "number", "scale_for", "stage_title", "with_std"]

_PREFIXES = ((1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"), (1e-12, "p"))
_NEVER = ("s", "K", "kg", "kg m", "kg m^2")
"""Units that are left as they are: a millikilogram helps nobody."""
ARCSEC = 180.0 * 3600.0 / math.pi
_STAGES = {"free_air": "Free air and wrist (torques)", "clamped": "Clamped (torques)", "poses": "Filtered poses"}


@dataclass(frozen=True)
class Scale:
    """A display unit: ``value / factor`` is in ``unit``."""

    factor: float
    unit: str


def stage_title(stage: str) -> str:
    """A stage's name for people."""
    return _STAGES.get(stage, stage)


def scale_for(unit: str, values: Sequence[float]) -> Scale:
    """The display unit of a column of numbers given in SI, chosen by the largest of them."""
    sizes = [abs(v) for v in values if math.isfinite(v) and v != 0.0]
    largest = max(sizes, default=0.0)
    pretty = unit.replace("^2", "²").replace("^3", "³").replace(" ", "·")
    if unit == "":
        return Scale(1e-6, "ppm") if 0.0 < largest < 1e-2 else Scale(1.0, "")
    if unit.startswith("1/"):
        return Scale(1e-6, "ppm" + pretty[1:]) if 0.0 < largest < 1e-2 else Scale(1.0, pretty)
    if unit in _NEVER or largest == 0.0:
        return Scale(1.0, pretty)
    if unit in ("m", "rad"):  # micrometres and microradians stay as long as they are short
        return Scale(1e-6, f"µ{unit}") if largest < 1e-2 else Scale(1e-3, f"m{unit}")
    for factor, prefix in _PREFIXES:
        if largest >= factor:
            return Scale(factor, prefix + pretty)
    return Scale(1e-12, "p" + pretty)


def fixed(value: float, decimals: int) -> str:
    """A number to so many decimals, in groups of three, without a negative zero."""
    if decimals < 0:
        value = round(value, decimals)
    text = f"{value:,.{max(decimals, 0)}f}".replace(",", "\u202f")
    return (
        "0" + text[2:]
        if text.startswith("-0") and float(f"{value:.{max(decimals, 0)}f}") == 0.0
        else text.replace("-", "−")
    )


def number(value: float, digits: int = 3) -> str:
    """A number to so many significant digits, without exponent where that is readable."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if -4 <= exponent < 7:
        return fixed(value, digits - 1 - exponent)
    mantissa = value / 10.0**exponent
    superscript = str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{mantissa:.{max(digits - 1, 0)}f}·10{superscript}".replace("-", "−")


def count_text(value: int) -> str:
    """A count, in groups of three."""
    return f"{value:,}".replace(",", "\u202f")


def with_std(value: float, std: float, scale: Scale, *, unit: bool = True) -> str:
    """``value ± std`` in the display unit, both to the second digit of the standard error."""
    v, s = value / scale.factor, std / scale.factor
    if not (math.isfinite(s) and s > 0.0):
        return f"{number(v)}{_tail(scale, unit)}"
    decimals = 1 - math.floor(math.log10(s))
    if abs(decimals) > 6:
        return f"{number(v)} ± {number(s, 2)}{_tail(scale, unit)}"
    return f"{fixed(v, decimals)} ± {fixed(s, decimals)}{_tail(scale, unit)}"


def _tail(scale: Scale, unit: bool) -> str:
    return f" {scale.unit}" if unit and scale.unit else ""


def error_text(value: float | None, unit: str) -> str:
    """An error of a stage: ``m`` as µm or mm; ``sigma`` as a multiple of the noise; ``Nm`` as it is."""
    if value is None or not math.isfinite(value):
        return "–"
    if unit == "sigma":
        return f"{number(value)} σ"
    if unit == "m":
        return f"{number(value * 1e6)} µm" if abs(value) < 1e-2 else f"{number(value * 1e3)} mm"
    return f"{number(value)} {unit}".rstrip()
