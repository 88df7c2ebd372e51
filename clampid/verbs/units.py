"""The only place where SI becomes what people read: mm, µm, µrad, degrees; values with their standard errors."""

from __future__ import annotations

import math

__all__ = ["error_text", "length", "quantity", "ranged", "readable", "span", "with_error"]

_SCALES: dict[str, tuple[tuple[float, float, str], ...]] = {
    # From which size on, factor, symbol: the first that fits.
    "m": ((1e-3, 1e3, "mm"), (0.0, 1e6, "µm")),
    "rad": ((math.radians(0.2), 180 / math.pi, "deg"), (0.0, 1e6, "µrad")),
    "rad/Nm": ((0.0, 1e6, "µrad/Nm"),),
    "rad/K": ((0.0, 1e6, "µrad/K"),),
    "rad/m": ((0.0, 1e6, "µrad/m"),),
    "1/K": ((0.0, 1e6, "1e-6/K"),),
    "m/N": ((0.0, 1e9, "nm/N"),),
    "m/Nm": ((0.0, 1e9, "nm/Nm"),),
    "m/s": ((0.0, 3.6e9, "µm/h"),),
    "kg m": ((0.0, 1.0, "kg·m"),),
    "kg m^2": ((0.0, 1.0, "kg·m²"),),
}
_EXACT = 12  # significant digits of a number without an uncertainty; nobody reads more


def _scale(unit: str, size: float) -> tuple[float, str]:
    for least, factor, symbol in _SCALES.get(unit, ((0.0, 1.0, unit),)):
        if size >= least:
            return factor, symbol
    return 1.0, unit


def readable(value: float, unit: str, digits: int = 3) -> str:
    """A number in the unit that suits its size, such as ``123 µm``.

    Parameters
    ----------
    value
        In SI.
    unit
        Of the value, one of :data:`clampid.effect.UNITS`, or ``sigma``.
    digits
        Significant digits.
    """
    if not math.isfinite(value):
        return "not known"
    factor, symbol = _scale(unit, abs(value))
    return f"{_rounded(value * factor, digits)} {symbol}".rstrip()


def quantity(value: float, std: float, unit: str) -> tuple[str, str, str]:
    """Value, standard error and unit as three columns of a table; both in the unit that suits the larger of them."""
    factor, symbol = _scale(unit, max(abs(value), std if math.isfinite(std) else 0.0))
    if not (math.isfinite(std) and std > 0):
        return _rounded(value * factor, 4), "–", symbol
    decimals = max(0, min(_EXACT, 1 - math.floor(math.log10(std * factor))))
    return f"{value * factor:.{decimals}f}", f"{std * factor:.{decimals}f}", symbol


def with_error(value: float, std: float, unit: str) -> str:
    """``12.3 ± 0.4 µm``."""
    number, error, symbol = quantity(value, std, unit)
    return f"{number} ± {error} {symbol}".rstrip()


def span(low: float, high: float, unit: str) -> str:
    """``12 – 340 µm``, both to two digits in the unit that suits the larger; one number where they read the same."""
    factor, symbol = _scale(unit, abs(high)) if unit or abs(high) > 1e-2 else (1e6, "ppm")
    scaled = (value * factor for value in (low, high))
    ends = dict.fromkeys(f"{v:.2g}" if abs(v) < 1e-3 else _rounded(v, 2) for v in scaled)
    return f"{' – '.join(ends)} {symbol}".rstrip()


def length(value: float) -> str:
    """A length with its unit, for sentences."""
    return readable(value, "m")


def ranged(value: float, unit: str) -> str:
    """An angle, length, torque, temperature or mass, as one compares it with the edge of a range."""
    factor, symbol, decimals = {
        "rad": (180 / math.pi, "deg", 1),
        "m": (1e3, "mm", 1),
        "degC": (1.0, "degC", 1),
        "kg": (1.0, "kg", 2),
    }.get(unit, (1.0, unit, 1))
    return f"{value * factor:.{decimals}f} {symbol}"


def error_text(value: float | None, unit: str) -> str:
    """An error of a table or stage: metres as mm or µm, ``sigma`` as a multiple of the noise."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:.3g} σ" if unit == "sigma" else readable(value, unit)


def _rounded(value: float, digits: int) -> str:
    if value == 0.0:
        return "0"
    decimals = digits - 1 - math.floor(math.log10(abs(value)))
    text = f"{round(value, decimals):.{max(decimals, 0)}f}"
    return f"{value:.{digits}g}" if decimals > _EXACT else text
