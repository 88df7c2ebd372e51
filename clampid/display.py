"""The only place where SI becomes what people read: one choice of units, one rule for digits.

A number with a standard error: two significant digits of the error, the value to the same place. A number without one:
three significant digits. Lengths are µm below 1 mm and mm from there on, angles µrad below 0.2 degrees.
Several numbers of one column share the unit that suits the largest. Minus signs are true ones, not hyphens.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

__all__ = [
    "MINUS",
    "Scale",
    "change_text",
    "compact",
    "count_text",
    "counted",
    "error_text",
    "error_texts",
    "fixed",
    "floor_text",
    "label_text",
    "length",
    "number",
    "odds_text",
    "places_text",
    "quantity",
    "ranged",
    "ranged_text",
    "readable",
    "scale_for",
    "span",
    "true_minus",
    "with_error",
    "with_std",
]

_SCALES: dict[str, tuple[tuple[float, float, str], ...]] = {
    # From which size on, factor, symbol: the first that fits.
    "m": ((1e-3, 1e3, "mm"), (0.0, 1e6, "µm")),
    "rad": ((math.radians(0.2), 180 / math.pi, "deg"), (0.0, 1e6, "µrad")),
    "microrad": ((0.0, 1e6, "µrad"),),  # an angle, rad, that stays in µrad whatever its size
    "rad/Nm": ((1e-3, 1e3, "mrad/Nm"), (0.0, 1e6, "µrad/Nm")),
    "rad/Nm^3": ((1e-3, 1e3, "mrad/Nm³"), (1e-6, 1e6, "µrad/Nm³"), (0.0, 1e9, "nrad/Nm³")),
    "rad/K": ((0.0, 1e6, "µrad/K"),),
    "rad/m": ((0.0, 1e6, "µrad/m"),),
    "1/K": ((0.0, 1e6, "ppm/K"),),
    "m/N": ((1e-6, 1e6, "µm/N"), (0.0, 1e9, "nm/N")),
    "m/Nm": ((1e-6, 1e6, "µm/Nm"), (0.0, 1e9, "nm/Nm")),
    "m/s": ((0.0, 3.6e9, "µm/h"),),
    "m/rad": ((1e-3, 1e3, "mm/rad"), (0.0, 1e6, "µm/rad")),
    "1/(N m^2)": ((1e-6, 1e6, "1e-6/(N·m²)"), (0.0, 1e9, "1e-9/(N·m²)")),
    "Nm s/rad": ((1.0, 1.0, "Nm·s/rad"), (0.0, 1e3, "mNm·s/rad")),
}
AT_FLOOR = 1.05
"""Up to so many noise floors an error is reported as being at the noise floor."""
_EXACT = 12  # significant digits of a number without an uncertainty; nobody reads more
CONSTANT = 1e-8  # of its value: a standard error below that share is none
_PLAIN = range(-4, 7)  # powers of ten that a number is printed without
_PLAIN_ODDS = 4  # powers of ten from which on odds are given as a power
_THIN = "\u202f"
MINUS = "−"
_HYPHENS = re.compile(r"(?P<kept>--[\w-]+[ =]\S+)|(?<![\w.)\]'\"=/-])-(?=\.?\d)")
"""A hyphen that is a number's sign, and options of a command with their values, which are kept to be copied."""


@dataclass(frozen=True)
class Scale:
    """A display unit: ``value * factor`` is in ``unit``."""

    factor: float
    unit: str


def scale_for(unit: str, values: Iterable[float]) -> Scale:
    """The display unit of numbers given in SI, chosen by the largest of them.

    Parameters
    ----------
    unit
        Of the values, one of :data:`clampid.effect.UNITS`, or ``sigma``.
    """
    size = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    for least, factor, symbol in _SCALES.get(unit, ()):
        if size >= least:
            return Scale(factor, symbol)
    return Scale(1.0, unit.replace("^2", "²").replace("^3", "³").replace(" ", "·"))


def fixed(value: float, decimals: int) -> str:
    """A number to so many decimals, or to tens and hundreds where negative; without a negative zero."""
    text = f"{round(value, decimals):.{max(decimals, 0)}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text.replace("-", MINUS)


def true_minus(text: str) -> str:
    """A text for people in which negative numbers have a minus sign instead of a hyphen; options of commands stay."""
    return _HYPHENS.sub(lambda found: found["kept"] or MINUS, text)


def odds_text(log_odds: float) -> str:
    """Odds, given as their natural logarithm: ``8.2 to 1``, and large ones as ``above 10³⁹ to 1``."""
    power = math.floor(log_odds / math.log(10.0))
    if power < _PLAIN_ODDS:
        return f"{number(math.exp(log_odds), 2)} to 1"
    return f"above 10{_raised(power)} to 1"


def number(value: float, digits: int = 3) -> str:
    """A number without an uncertainty, to so many significant digits."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")  # 9.996 is 10.0, not 10.00
    if int(exponent) not in _PLAIN:
        return f"{mantissa.replace('-', MINUS)}·10{_raised(int(exponent))}"
    return fixed(value, digits - 1 - int(exponent))


def _place(std: float) -> int:
    """The decimals that leave two significant digits of a standard error."""
    return min(_EXACT, 1 - int(f"{std:.1e}".split("e")[1]))


def _has_error(value: float, std: float) -> bool:
    """Whether there is a standard error: fixed parameters have none, or one of the size of rounding."""
    return math.isfinite(std) and std > CONSTANT * abs(value)


def _pair(value: float, std: float) -> tuple[str, str]:
    if not _has_error(value, std):
        return number(value, 4), ""
    return fixed(value, _place(std)), fixed(std, _place(std))


def _raised(power: int) -> str:
    """A power of ten as it stands beside the ten."""
    return str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def with_std(value: float, std: float, scale: Scale, *, unit: bool = True) -> str:
    """``12.34 ± 0.42 µm``: a value and its standard error, SI, in a unit chosen before."""
    worded, error = _pair(value * scale.factor, std * scale.factor)
    both = f"{worded} ± {error}" if error else worded
    return f"{both} {scale.unit}".rstrip() if unit else both


def compact(value: float, std: float, scale: Scale) -> str:
    """``12.34(42)``: a value and in brackets the standard error of its last digits, without the unit.

    Two digits of an error that begins with 1 or 2, one of others.
    """
    value, std = value * scale.factor, std * scale.factor
    if not (_has_error(value, std) and math.isfinite(value)):
        return number(value, 4)
    first = f"{std:.1e}"
    decimals = _place(std) - (0 if first[0] in "12" else 1)
    if decimals > 0:
        return f"{fixed(value, decimals)}({round(std * 10**decimals):d})"
    return f"{fixed(value, decimals)}({fixed(std, decimals)})"


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
    scale = scale_for(unit, [value])
    return f"{number(value * scale.factor, digits)} {scale.unit}".rstrip()


def quantity(value: float, std: float, unit: str) -> tuple[str, str, str]:
    """Value, standard error and unit as three columns of a table; both in the unit that suits the larger of them."""
    scale = scale_for(unit, (value, std))
    worded, error = _pair(value * scale.factor, std * scale.factor)
    return worded, error or "–", scale.unit


def with_error(value: float, std: float, unit: str) -> str:
    """``12.34 ± 0.42 µm``, in the unit that suits the larger; without an error ``±`` is followed by a dash."""
    worded, error, symbol = quantity(value, std, unit)
    return f"{worded} ± {error} {symbol}".rstrip()


def change_text(change: float, std: float, unit: str) -> str:
    """``−52.9 ± 6.9 µm``: a change with its sign and its standard error; ``sigma`` is printed as σ."""
    worded, error, symbol = quantity(abs(change), std, "" if unit == "sigma" else unit)
    known = f" ± {error}" if error != "–" else ""
    return f"{'+' if change > 0 else MINUS}{worded}{known} {'σ' if unit == 'sigma' else symbol}".rstrip()


def span(low: float, high: float, unit: str) -> str:
    """``12 – 340 µm``, both to two digits in the unit that suits the larger; one number where they read the same."""
    scale = scale_for(unit, [high]) if unit or abs(high) > 1e-2 else Scale(1e6, "ppm")
    ends = dict.fromkeys(number(v * scale.factor, 2) for v in (low, high))
    return f"{' – '.join(ends)} {scale.unit}".rstrip()


def ranged_text(ends: Iterable[float], unit: str) -> str:
    """``78.0 – 171 µm``: an interval, both ends to three digits in the unit that suits the larger."""
    values = tuple(ends)
    scale = scale_for(unit, values)
    return f"{' – '.join(number(value * scale.factor) for value in values)} {scale.unit}".rstrip()


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
    return f"{fixed(value * factor, decimals)} {symbol}"


def floor_text(errors: Iterable[tuple[float | None, float | None]]) -> str:
    """Where held-out errors that are near their noise floors lie: ``the held-out error is 1.13 times the noise floor``.

    Parameters
    ----------
    errors
        Of each stage the held-out error and its noise floor, in one unit; of several the largest ratio is given.
    """
    times = [error / floor for error, floor in errors if error and floor]
    if not times:
        return "the noise floor of the held-out error is not known"
    if max(times) <= AT_FLOOR:
        return "the held-out error is at the noise floor"
    most = "up to " if len(times) > 1 else ""
    return f"the held-out error is {most}{max(times):.2f} times the noise floor"


def error_text(value: float | None, unit: str, digits: int = 3) -> str:
    """An error of a table or stage: metres as mm or µm, ``sigma`` as a multiple of the noise."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{number(value, digits)} σ" if unit == "sigma" else readable(value, unit, digits)


def error_texts(values: Iterable[float | None], unit: str) -> list[str]:
    """Errors beside each other, with as many digits, from three to five, as it takes to tell different ones apart."""
    listed = list(values)
    three, four, five = ([error_text(v, unit, digits) for v in listed] for digits in (3, 4, 5))
    return next(texts for texts in (three, four, five) if len(set(texts)) == len(set(five)))


def count_text(value: int) -> str:
    """A count, in groups of three."""
    return f"{value:,}".replace(",", _THIN)


def counted(number: int, what: str, verb: str = "") -> str:
    """``1 row was`` or ``13 423 rows were``: a number, what it counts, and a verb (``was``, ``lies``) that agrees."""
    plural = {"": "", "was": " were", "is": " are", "has": " have", "lies": " lie"}
    agrees = plural[verb] if number != 1 else f" {verb}" if verb else ""
    return f"{count_text(number)} {what}{'' if number == 1 else 's'}{agrees}"


def label_text(effect: str, places: Sequence[str]) -> str:
    """``backlash@joint1``, ``backlash at joints 1, 2``, or the effect alone."""
    return f"{effect} at {places_text(places)}" if len(places) > 1 else "@".join([effect, *places])


def places_text(places: Sequence[str]) -> str:
    """``joints 1, 3–6``, or each with its own name."""
    kind = places[0].rstrip("0123456789") if places else ""
    numbers = [place.removeprefix(kind) for place in places]
    if len(places) < 2 or not all(number.isdigit() for number in numbers):
        return ", ".join(places)
    runs: list[list[int]] = []
    for number in sorted(map(int, numbers)):
        if runs and runs[-1][-1] == number - 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    spans = [f"{run[0]}–{run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs]
    return f"{kind}s {', '.join(spans)}"
