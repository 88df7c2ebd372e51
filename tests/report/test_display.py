"""Numbers as people read them."""

import pytest

from clampid.report.display import Scale, error_text, fixed, number, scale_for, with_std


@pytest.mark.parametrize(
    ("unit", "values", "expected"),
    [
        ("m", [3e-4, 1e-5], Scale(1e-6, "µm")),
        ("m", [0.028], Scale(1e-3, "mm")),
        ("rad", [1.2e-4], Scale(1e-6, "µrad")),
        ("rad/Nm", [0.25], Scale(1e-3, "mrad/Nm")),
        ("1/K", [1.2e-5], Scale(1e-6, "ppm/K")),
        ("", [2e-5], Scale(1e-6, "ppm")),
        ("kg m", [0.02], Scale(1.0, "kg·m")),
        ("Nm s/rad", [2e-3], Scale(1e-3, "mNm·s/rad")),
        ("rad", [0.0], Scale(1.0, "rad")),
    ],
)
def test_scale(unit, values, expected):
    assert scale_for(unit, values) == expected


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (1.234e-4, 3.2e-6, "123.4 ± 3.2 µm"),
        (-1.2e-5, 0.9e-6, "−12.00 ± 0.90 µm"),
        (1e-6, 4e-5, "1 ± 40 µm"),
        (1.5e-3, 2.6e-4, "1\u202f500 ± 260 µm"),
        (2e-5, 0.0, "20.0 µm"),
    ],
)
def test_with_std(value, std, text):
    assert with_std(value, std, Scale(1e-6, "µm")) == text


def test_number():
    assert number(0.0) == "0"
    assert number(float("nan")) == "–"
    assert number(1.0e-30, 2) == "1.0·10⁻³⁰"
    assert number(-12345.0) == "−12\u202f300"
    assert fixed(-1e-9, 3) == "0.000"


def test_error_text():
    assert error_text(1.1e-4, "m") == "110 µm"
    assert error_text(0.028, "m") == "28.0 mm"
    assert error_text(1.3, "sigma") == "1.30 σ"
    assert error_text(None, "m") == "–"
