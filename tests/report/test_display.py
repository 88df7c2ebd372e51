"""Numbers as people read them: one choice of units and one rule for digits, wherever they are printed."""

import pytest

from clampid.diagnosis.omission import shift_in_words
from clampid.display import (
    Scale,
    error_text,
    error_texts,
    fixed,
    number,
    ranged_text,
    scale_for,
    true_minus,
    with_error,
    with_std,
)
from clampid.report.page import _typeset


@pytest.mark.parametrize(
    ("unit", "values", "expected"),
    [
        ("m", [3e-4, 1e-5], Scale(1e6, "µm")),
        ("m", [3e-4, -1.2e-3], Scale(1e3, "mm")),
        ("rad", [1.2e-4, float("nan")], Scale(1e6, "µrad")),
        ("rad/Nm", [0.25], Scale(1e3, "mrad/Nm")),
        ("1/K", [1.2e-5], Scale(1e6, "ppm/K")),
        ("kg m^2", [0.02], Scale(1.0, "kg·m²")),
        ("Nm s/rad", [2e-3], Scale(1e3, "mNm·s/rad")),
        ("A s/rad", [2e-3], Scale(1.0, "A·s/rad")),
        ("rad", [0.0], Scale(1e6, "µrad")),
    ],
)
def test_the_largest_of_a_column_chooses_its_unit(unit, values, expected):
    assert scale_for(unit, values) == expected


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (1.234e-4, 3.2e-6, "123.4 ± 3.2 µm"),
        (-1.2e-5, 0.9e-6, "−12.00 ± 0.90 µm"),
        (1e-6, 4e-5, "1 ± 40 µm"),
        (-1384e-6, 48.8e-6, "−1384 ± 49 µm"),
        (0.555293, 2.9e-3, "555300 ± 2900 µm"),
        (1e-4, 9.96e-6, "100 ± 10 µm"),
        (-1e-9, 3e-6, "0.0 ± 3.0 µm"),
        (2e-5, 0.0, "20.00 µm"),
    ],
)
def test_two_digits_of_the_error_and_the_value_to_the_same_place(value, std, text):
    assert with_std(value, std, Scale(1e6, "µm")) == text


def test_a_stiffness_has_the_digits_of_its_error():
    assert with_error(12.4987, 0.0781, "Nm/rad") == "12.499 ± 0.078 Nm/rad"


def test_three_digits_without_an_error_and_no_computers_exponents():
    assert number(97.0) == "97.0"
    assert number(1523.4) == "1520"
    assert number(9.996) == "10.0"
    assert number(0.0) == "0"
    assert number(float("nan")) == "–"
    assert number(1.0e-30, 2) == "1.0·10⁻³⁰"
    assert number(-12345.0) == "−12300"
    assert fixed(-1e-9, 3) == "0.000"


def test_errors_of_stages():
    assert error_text(1.52e-3, "m") == "1.52 mm"
    assert error_text(5.889e-4, "m") == "589 µm"
    assert error_text(0.028, "m") == "28.0 mm"
    assert error_text(1520.3, "sigma") == "1520 σ"
    assert error_text(None, "m") == "–"
    assert ranged_text((1.5e-4, 2.44e-3), "m") == "0.150 – 2.44 mm"


def test_sentences_have_the_same_digits():
    shift = {"row": "base", "parameter": "rz", "shift": -1.384e-3, "std": 4.88e-5, "unit": "rad", "at_flange_m": 2e-3}
    assert "rz of base by −1384 ± 49 µrad" in shift_in_words([shift])


def test_a_page_sets_minus_and_thousands():
    assert true_minus("-1384 ± 49") == "−1384 ± 49"
    assert _typeset("555300.25 ± 12000") == "555\u202f300.25 ± 12\u202f000"
    assert _typeset("joint-1, 0.12345") == true_minus("joint-1, 0.12345") == "joint-1, 0.12345"


def test_errors_beside_each_other_have_the_digits_that_tell_them_apart() -> None:
    assert error_texts([1.0742, 1.0669], "sigma") == ["1.074 σ", "1.067 σ"]
    assert error_texts([2.77e-4, 7.94e-5], "m") == ["277 µm", "79.4 µm"]
    assert error_texts([52.234e-6, 52.198e-6], "m") == ["52.23 µm", "52.20 µm"]
    assert error_texts([1.0, 1.0 + 1e-9, None], "sigma") == ["1.00 σ", "1.00 σ", "–"]
