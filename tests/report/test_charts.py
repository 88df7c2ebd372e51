"""Figures as SVG: marks lie where their values are, ticks are round, and bad numbers are not drawn."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from clampid.charts import Axis, Band, Bars, Cells, Chart, Label, Level, Line, Panel, Points, Segments, Span
from clampid.charts.draw import pieces, shape
from clampid.charts.scale import Box, Scale, number, scales
from clampid.charts.svg import boxes, standalone, svg

BOX = Box(10.0, 20.0, 200.0, 100.0)
SVG = "{http://www.w3.org/2000/svg}"


def scale(low: float, high: float, length: float = 200.0, **axis: object) -> Scale:
    return Scale(low, high, 0.0, length, Axis(**axis))  # type: ignore[arg-type]


def test_ends_of_an_axis_are_the_ends_of_the_panel() -> None:
    x, y = scales(Panel((), Axis(low=-2.0, high=3.0), Axis(low=0.0, high=1.0)), BOX)
    np.testing.assert_allclose(x([-2.0, 3.0, 0.5]), [10.0, 210.0, 110.0])
    np.testing.assert_allclose(y([0.0, 1.0]), [120.0, 20.0])  # upwards
    _, down = scales(Panel((), Axis(), Axis(low=0.0, high=1.0, flipped=True)), BOX)
    np.testing.assert_allclose(down([0.0, 1.0]), [20.0, 120.0])


def test_a_logarithmic_axis_has_equal_steps_for_equal_factors_and_no_place_for_zero() -> None:
    log = scale(1.0, 100.0, log=True)
    np.testing.assert_allclose(log([1.0, 10.0, 100.0]), [0.0, 100.0, 200.0])
    assert np.isnan(log([0.0, -1.0])).all()
    assert [text for _, text in log.ticks(60.0)] == ["1", "10", "100"]


@pytest.mark.parametrize(("low", "high"), [(-0.33, 0.33), (0.0, 1e-7), (-1e6, 3e6), (19.9, 20.1)])
def test_ticks_are_round_within_the_axis_and_neither_none_nor_too_many(low: float, high: float) -> None:
    ticks = scale(low, high, 200.0).ticks(40.0)
    assert 2 <= len(ticks) <= 5
    assert all(low - 1e-9 * (high - low) <= value <= high + 1e-9 * (high - low) for value, _ in ticks)
    assert len({text for _, text in ticks}) == len(ticks)
    for value, text in ticks:
        assert float(text.replace("−", "-")) == pytest.approx(value, abs=1e-6 * (high - low))


def test_a_tick_has_the_digits_of_its_step() -> None:
    assert [number(v, 0.05) for v in (-0.1, 0.0, 0.05)] == ["−0.10", "0", "0.05"]


def test_equal_axes_have_one_scale() -> None:
    panel = Panel((Points(np.array([0.0, 1.0]), np.array([0.0, 5.0])),), equal=True)
    x, y = scales(panel, BOX)
    assert float(x(1.0) - x(0.0)) == pytest.approx(float(y(0.0) - y(1.0)))


def test_a_line_is_parted_where_a_number_is_not_finite() -> None:
    x = np.arange(6.0)
    y = np.array([1.0, 2.0, np.nan, 3.0, np.inf, 4.0])
    assert [run.tolist() for run in pieces(x, y)] == [[0, 1], [3], [5]]
    assert pieces(np.full(3, np.nan), x[:3]) == []


def all_marks() -> Chart:
    x, y = np.array([0.0, 1.0, np.nan, 3.0]), np.array([2.0, -1.0, 0.5, np.nan])
    first = Panel(
        (
            Level(0.2),
            Points(x, y, "points", size=3, error=np.ones(4), tips=("a <b>", "c", "d", "e")),
            Band(x, y - 1, y + 1, "band", "grey"),
            Line(x, y, "line & more", steps=True, symbol="diamond"),
            Span(0.2, 0.4),
            Label(("one", "two")),
        ),
        Axis("x, m"),
        Axis("y, µm"),
    )
    second = Panel((Bars(np.array([1.0, np.nan]), ("blue", "green"), tips=("1", "–")), Level(2.0, "x")), Axis("Nm"))
    third = Panel((Cells(np.array([[1.0, -0.5]]), [["1", "-0.5"]]), Segments(np.zeros((1, 2)), np.ones((1, 2)), "s")))
    return Chart((first, second, third), 300)


def test_every_mark_is_drawn_as_well_formed_svg_without_bad_numbers() -> None:
    text = svg(all_marks(), "key", "what it shows")
    root = ElementTree.fromstring(text)
    assert root.get("id") == "key"
    assert "nan" not in text
    assert "inf" not in text
    assert [node.text for node in root.iter(f"{SVG}title")][:2] == ["a <b>", "c"]  # the points that are finite
    assert [node.text for node in root.iter(f"{SVG}text") if node.get("class") == "key"] == [
        "points",
        "band",
        "line & more",
        "s",
    ]
    assert "−0.5" in text


def test_a_point_lies_where_its_value_is() -> None:
    whole = Axis(low=0.0, high=1.0)
    chart = Chart((Panel((Points(np.array([0.25]), np.array([0.5])),), whole, whole),))
    (box,) = boxes(chart)
    found = re.search(r'class="points"><path [^>]*d="M([\d.]+) ([\d.]+)h0"', svg(chart))
    assert found is not None
    assert float(found[1]) == pytest.approx(0.25 * box.w, abs=0.06)  # the panel's own corner is 0, 0
    assert float(found[2]) == pytest.approx(0.5 * box.h, abs=0.06)


def test_panels_lie_within_the_drawing_and_not_on_each_other() -> None:
    chart = Chart((Panel((Level(1.0),), title="a"),) * 7, 600, below="time, s")
    found = boxes(chart)
    assert len(found) == 7
    for k, a in enumerate(found):
        assert a.w > 100
        assert a.h > 50
        assert a.y + a.h < 600
        assert a.x + a.w <= 1080
        for b in found[:k]:
            assert a.x >= b.x + b.w or b.x >= a.x + a.w or a.y >= b.y + b.h or b.y >= a.y + a.h


def test_alone_it_has_its_style_and_in_a_page_it_has_not() -> None:
    assert "<style>" in standalone(all_marks())
    assert "<style>" not in svg(all_marks())


def test_an_unknown_symbol_is_refused() -> None:
    with pytest.raises(ValueError, match="symbol 'star': expected circle"):
        shape("star", 3.0)
