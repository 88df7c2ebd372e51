"""The report's evidence: effects by the name that the catalogue gives them, and no value that the data do not hold."""

from __future__ import annotations

from typing import Any

from clampid.report.evidence import evidence


def candidate(*known: bool) -> dict[str, Any]:
    """A candidate of the family gear_eccentricity; of its parameters ``known`` are identified."""
    parameters = [
        {"name": f"joint_angle_curve.a{k}@joint1", "value": 1e-4, "std": 1e-5, "unit": "rad", "identified": is_known}
        for k, is_known in enumerate(known)
    ]
    return {"effect": "gear_eccentricity", "name": "joint_angle_curve", "where": ["joint1"], "alternative": False,
            "parameters": parameters, "p_value": 1e-9, "p_familywise": 0.005}  # fmt: skip


def cells(*known: bool) -> dict[str, str]:
    (table,) = evidence({"unit": "m", "candidates": [candidate(*known)]}, "m")
    return dict(zip([str(h).removesuffix("#") for h in table.columns], map(str, table.rows[0]), strict=True))


def test_a_candidate_has_its_own_name_and_not_its_family() -> None:
    assert cells(True)["Effect"] == "joint_angle_curve"


def test_parameters_that_the_data_do_not_determine_have_no_value() -> None:
    assert cells(True, True)["Parameters"] == "a0 = 100 ± 10 µrad, a1 = 100 ± 10 µrad"
    assert cells(True, False, False)["Parameters"] == "a0 = 100 ± 10 µrad; 2 not identifiable"
    assert cells(False)["Parameters"] == "not identifiable"
