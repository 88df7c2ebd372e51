"""The verdict's words and tables."""

from dataclasses import replace

import numpy as np

from clampid.models.model import Model, Round
from clampid.report.evidence import confusable_text, evidence, parameters_text
from clampid.report.verdict import headline, truth_section, verdict_section
from clampid.slots import Layout


def model(*errors: float, stage="poses") -> Model:
    rounds = tuple(Round(stage, ("geometry",), (), e, e, 1e-4) for e in errors)
    return Model("robot", Layout(6), {stage: None}, (), rounds)  # type: ignore[dict-item]


def test_the_headline_gives_the_error_before_and_now():
    (text,) = headline(
        model(2e-4, 1.1e-4), None, None, {"stages": {"poses": {"verdict": "missing", "summary": "A gap"}}}
    )
    assert "A gap." in text
    assert "fell from 200 µm to 110 µm; the noise floor is 100 µm" in text


def test_the_headline_does_not_say_it_twice():
    found = {"verdict": "missing", "summary": "With it the held-out error falls to 110 µm", "heldout_rms_after": 1.1e-4}
    (text,) = headline(model(2e-4, 1.1e-4), None, None, {"stages": {"poses": found}})
    assert text.count("110 µm") == 1


def test_an_error_that_rose_is_not_said_to_fall():
    (text,) = headline(model(1e-4, 2e-4), None, None, None)
    assert "rose" in text
    (text,) = headline(model(1e-4, 1.001e-4), None, None, None)
    assert "stayed" in text


def test_rounds_of_the_first_model_come_first():
    (text,) = headline(model(1e-4), model(3e-4), None, None)
    assert "fell from 300 µm to 100 µm" in text


def test_comparison_alone():
    tables = {"poses": {"unit": "m", "rms": 1e-4, "noise_floor": 9e-5, "heldout": {"rms": 1.5e-4, "rows": 3}}}
    (text,) = headline(replace(model(), ledger=()), None, {"tables": tables}, None)
    assert "is 150 µm; the noise floor is 90.0 µm" in text


def test_considered_once_and_empty_columns_left_out():
    looked = [
        {"effect": "stribeck_friction", "where": ["joint1"], "p_value": 0.03, "p_familywise": 0.7},
        {"effect": "stribeck_friction", "where": ["joint1"], "p_value": 0.01, "p_familywise": 0.4},
        {"effect": "probe", "where": ["joint2"], "p_value": 0.01, "p_familywise": 0.5, "depends_on": ["q3"]},
    ]
    (table,) = evidence({"considered": looked}, "sigma")
    assert [row[:2] for row in table.rows] == [("stribeck_friction", "joint1"), ("probe", "joint2")]
    assert table.rows[0][3] == "0.40"
    assert table.columns == ("Effect", "At", "p, alone#", "p, family-wise#", "Remark")
    assert table.rows[1][4] == "depends on q3"


def test_what_was_refused_stands_first_with_the_reason_and_is_never_cut():
    looked = [
        {"effect": f"effect{k}", "where": [], "p_value": 1e-9, "p_familywise": 0.005, "state": "testable"}
        for k in range(20)
    ]
    tried = {"effect": "effect3", "where": [], "p_value": 0.1, "p_familywise": 0.5, "reason": "it does not fall"}
    (table,) = evidence({"considered": [*looked, tried]}, "m")
    assert len(table.rows) == 12
    assert table.rows[0][0] == "effect3"
    assert table.rows[0][table.columns.index("Remark")] == "it does not fall"
    assert "8 more are not shown" in table.caption
    (table,) = evidence({"considered": [{**c, "reason": "no"} for c in looked]}, "m")
    assert len(table.rows) == 20


def test_variants_that_are_confusable_at_one_place_are_named_once():
    alike = [{"effect": "nonlinear_stiffness", "where": [w]} for w in ("joint1", "joint1", "joint2")]
    assert confusable_text({"confusable_with": alike}) == "nonlinear_stiffness @ joint1; nonlinear_stiffness @ joint2"


def test_limits_and_shifts():
    testability = [
        {"effect": "backlash", "name": "backlash", "where": [f"joint{i}"], "state": state,
         "limits": [{"name": f"backlash.gap@joint{i}", "limit": limit, "unit": "rad", "size": 1e-4}]}
        for i, state, limit in ((1, "testable", 2e-5), (2, "absorbed", None), (3, "weak", 1e-2))
    ]  # fmt: skip
    omission = [{"name": "geometry.x@link2", "shift": 2.1e-4, "std": 1.3e-5, "unit": "m"}]
    shifts, limits = evidence({"testability": testability, "omission": omission}, "m")
    assert shifts.rows == (("geometry.x@link2", "210 ± 13 µm"),)
    assert limits.rows == (("backlash.gap", "joint1", "20 µrad"),)
    assert "backlash@joint2 (absorbed by the model)" in limits.caption


def test_parameters_of_a_candidate_and_of_a_truth():
    assert parameters_text([{"name": "gap", "value": 1e-4, "std": 1e-5, "unit": "rad"}]) == "gap = 100 ± 10 µrad"
    assert parameters_text({"gap_rad": 1e-4, "shape": "round"}) == "gap_rad = 0.000100, shape = round"


def test_outliers_in_their_unit():
    (table,) = evidence({"unit": "sigma", "outliers": [{"table": "wrist", "row": 7, "size": 0.5}]}, "sigma")
    assert table.rows == (("wrist", "7", "0.500 Nm"),)


def test_nothing_to_report():
    assert verdict_section(None, None) is None
    assert truth_section(None) is None
    assert "Nothing." in truth_section([]).paragraphs


def test_what_was_found_is_not_among_what_was_not_confirmed():
    either = {"effect": "gear_eccentricity", "where": ["joint1"], "p_value": 1e-9, "p_familywise": 0.005}
    other = {"effect": "backlash", "where": ["joint1"], "p_value": 0.2, "p_familywise": 0.9}
    elsewhere = {**either, "where": ["joint2"]}
    found, looked = evidence(
        {"candidates": [{**either, "alternative": True}], "considered": [either, other, elsewhere]}, "m"
    )
    assert found.rows[0][0] == "gear_eccentricity (one of the alternatives)"
    assert sorted(row[:2] for row in looked.rows) == [("backlash", "joint1"), ("gear_eccentricity", "joint2")]


def test_no_median_is_drawn_across_a_gap():
    from clampid.report.variables import trend

    x = np.r_[np.linspace(0, 10, 300), np.linspace(20, 30, 300)]
    line = trend(x, x, np.ones(600, dtype=bool))
    (cut,) = np.flatnonzero(np.isnan(line.x))
    assert line.x[cut - 1] < 10.0 < 20.0 < line.x[cut + 1]
    assert np.isnan(line.median[cut])
    assert np.isnan(line.low[cut])  # so that the band is parted, too
    few = trend(np.repeat([0.0, 10.0], 50), np.arange(100.0), np.ones(100, dtype=bool))  # a category has no gaps
    assert np.isfinite(few.x).all()


def test_medians_and_chance():
    from clampid.report.variables import trend

    x = np.linspace(0, 1, 600)
    line = trend(x, 3 * x, np.ones(600, dtype=bool))
    np.testing.assert_allclose(line.median, 3 * line.x, atol=0.02)
    assert np.all(line.low < line.median)
    assert np.all(line.high > line.median)
