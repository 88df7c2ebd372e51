"""Results print short, and show themselves in a notebook: summary, table, figure, HTML."""

from __future__ import annotations

import pytest

import clampid
from clampid.shown import Shown


@pytest.fixture(scope="module")
def results(simulated) -> dict[str, Shown]:
    campaign = simulated(
        seed=3, poses=80, tables=("poses", "verification"), robot="ur10", hidden=("gear_eccentricity@joint2:3",)
    )
    model = clampid.identify(campaign)
    mended, addition = clampid.add(model, campaign, ["gear_eccentricity@joint2"])
    diagnosis = clampid.diagnose(model, campaign, flips=99)
    return {
        "Model": mended,
        "Addition": addition,
        "Diagnosis": diagnosis,
        "Comparison": clampid.compare(model, campaign),
    }


@pytest.mark.parametrize("name", ["Model", "Addition", "Diagnosis", "Comparison"])
def test_results_show_themselves(results: dict[str, Shown], name: str):
    """The representation of a diagnosis had 9.9 MB."""
    found = results[name]
    assert repr(found).startswith(f"<{name}: ")
    assert len(repr(found)) < 400
    assert "\n" not in repr(found)
    summary = found.summary()
    assert found.title() in summary
    assert "µm" in summary
    assert "noise floor" in summary
    frame = found.to_frame()
    assert len(frame) == len(found.records()) > 0
    html = found._repr_html_()
    assert "<table" in html
    assert len(html) < 50_000
    figure = found.plot()
    assert len(figure.panels) == len(found.errors()) > 0
    assert all(value > 0.0 for panel in figure.panels for bars in panel.marks for value in bars.lengths)
    assert all(panel.x.title in {"error, rms [µm]", "error, rms [σ]"} for panel in figure.panels)
    assert figure._repr_svg_().startswith("<svg xmlns=")


def test_a_campaign_and_its_robot_print_short(simulated):
    campaign = simulated(
        seed=3, poses=80, tables=("poses", "verification"), robot="ur10", hidden=("gear_eccentricity@joint2:3",)
    )
    assert repr(campaign).startswith(f"<Campaign: {campaign.name} of ur10; poses (")
    assert max(len(repr(campaign)), len(repr(campaign.robot))) < 200


def test_stages_print_short_too(results):
    assert repr(results["Diagnosis"].stages["poses"]).startswith("<StageDiagnosis: poses: ")
    assert len(repr(results["Model"].stages["poses"])) < 200


def test_the_version_is_that_of_the_package():
    from importlib.metadata import version

    assert clampid.__version__ == version("clampid")
