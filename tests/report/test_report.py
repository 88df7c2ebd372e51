"""The report: one file that opens offline, holds every section, and says what is not known."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from clampid.identification.identify import identify
from clampid.report import write_report
from experiments.campaign import read_campaign, write_campaign
from experiments.virtual_robot import Hidden, measure
from kinematics.description import load_robot

ROBOT = "kuka_kr20_r1810"
SECTIONS = (
    "What was measured",
    "The error, round by round",
    "The verdict and its evidence",
    "What had been hidden",
    "Where it fails",
    "The errors in space",
    "Error budget by effect",
    "Torques",
    "Drives",
    "The model with standard errors",
    "Sources, and how to do it again",
)


def candidate(effect, where, **extra):
    parameters = [{"name": "a1", "value": 1.234e-4, "std": 3.2e-6, "unit": "rad"}]
    return {
        "effect": effect,
        "where": where,
        "alternative": False,
        "p_value": 1e-30,
        "p_familywise": 0.005,
        "heldout_rms_before": 2.1e-4,
        "heldout_rms_after": 1.08e-4,
        "parameters": parameters,
        "confusable_with": [],
        **extra,
    }


DIAGNOSIS = {
    "stages": {
        "poses": {
            "verdict": "missing",
            "unit": "m",
            "noise_floor": 1.04e-4,
            "heldout_rms_before": 2.1e-4,
            "heldout_rms_after": 1.08e-4,
            "candidates": [candidate("gear_eccentricity", ["joint3"])],
            "considered": [candidate("thermal_expansion", ["link2"], confusable_with=["base_tilt"], p_value=0.0)],
            "depends_on": ["q3"],
            "outliers": [{"table": "poses", "row": 17, "size": 0.004}],
            "next_measurement": "more poses <of joint 3>",
            "summary": "Joint 3's gear runs out & in",
        },
        "free_air": {
            "verdict": "adequate",
            "unit": "sigma",
            "noise_floor": 1.0,
            "heldout_rms_before": 1.1,
            "heldout_rms_after": 1.1,
            "candidates": [],
            "considered": [],
            "depends_on": [],
            "outliers": [],
            "next_measurement": None,
            "summary": "nothing was found beyond the noise",
        },
    }
}
COMPARISON = {
    "tables": {
        "poses": {
            "unit": "m",
            "rows": 90,
            "rms": 1.1e-4,
            "mean": 1e-4,
            "max": 3.2e-4,
            "p95": 2e-4,
            "noise_floor": 1.04e-4,
            "noise_source": "instrument",
            "heldout": {"rows": 24, "rms": 1.2e-4, "mean": 1.1e-4, "max": 3.5e-4},
        },
        "free_air": {
            "unit": "sigma",
            "rms": 1.3,
            "noise_floor": 1.0,
            "heldout": {"rows": 900, "rms": 1.4},
            "per_motor": [
                {"rms_Nm": 0.05, "noise_floor_Nm": 0.04, "r2": 0.998, "heldout": {"rms_Nm": 0.05, "r2": 0.997}}
            ],
        },
    }
}


class Assets(HTMLParser):
    """What a browser would fetch, the text that a reader sees, and every script."""

    def __init__(self):
        super().__init__()
        self.fetched, self.text, self.scripts, self.inside = [], [], [], None

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        if tag in ("link", "img", "iframe", "source", "object", "embed") or (tag == "script" and "src" in found):
            self.fetched.append((tag, found))
        if tag in ("script", "style"):
            self.inside = (tag, found)
            self.scripts.append((tag, found, []))

    def handle_endtag(self, tag):
        if tag in ("script", "style"):
            self.inside = None

    def handle_data(self, data):
        if self.inside:
            self.scripts[-1][2].append(data)
        else:
            self.text.append(data)


SVG = "{http://www.w3.org/2000/svg}"
UNITS = "µm|mm|m|µrad|rad|rad/s|deg|degrees|Nm|s|min|°C|σ|1/σ|±1|0 to 1"
UNIT = re.compile(rf", ({UNITS})$|\(σ\)$|^Nm$|^(torque at|row of the table.*)$")


def drawings(path):
    """Every figure of the page by its key, read as XML."""
    text = Path(path).read_text(encoding="utf-8")
    found = re.findall(r'(<svg xmlns="[^"]*" class="chart" id="([^"]*)".*?\n</svg>)\n', text, re.DOTALL)
    return {key: ElementTree.fromstring(drawing) for drawing, key in found}


def parse(path):
    assets = Assets()
    assets.feed(Path(path).read_text(encoding="utf-8"))
    return assets, re.sub(r"\s+", " ", " ".join(assets.text))


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A small campaign of all tables and two models of it: as identified, and with something added."""
    made = measure(load_robot(ROBOT), [Hidden("gear_eccentricity", "joint3")], seed=3, poses=30)
    step = {"free_air": 16, "wrist": 4, "clamped": 3}
    tables = {name: frame.iloc[:: step.get(name, 1)].reset_index(drop=True) for name, frame in made.tables.items()}
    folder = tmp_path_factory.mktemp("report") / "campaign"
    write_campaign(folder, made.header, tables, "csv")
    campaign = read_campaign(folder)
    first = identify(campaign, holdout=0.2, seed=1)
    poses = [
        "geometry",
        "joint_compliance",
        "backlash",
        "gravity",
        "wrist_coupling_friction",
        "gear_eccentricity@joint3",
    ]
    return campaign, first, identify(campaign, {"poses": poses}, holdout=0.2, seed=1), made.hidden


@pytest.fixture(scope="module")
def page(measured, tmp_path_factory):
    campaign, first, model, hidden = measured
    path = tmp_path_factory.mktemp("page") / "report.html"
    write_report(path, model, campaign, comparison=COMPARISON, diagnosis=DIAGNOSIS, first_model=first, truth=hidden)
    return path


def test_one_file_that_fetches_nothing(page):
    assets, _ = parse(page)
    assert assets.fetched == []
    assert page.stat().st_size < 2e6
    assert [p.name for p in page.parent.iterdir()] == ["report.html"]  # no temporary file is left
    styles = "".join(d for tag, _, data in assets.scripts if tag == "style" for d in data)
    assert "url(" not in styles
    assert "@import" not in styles


def test_the_page_needs_no_script_but_to_choose_a_variable(page):
    assets, _ = parse(page)
    scripts = [("".join(data), found) for tag, found, data in assets.scripts if tag == "script"]
    assert sum(len(text) for text, found in scripts if "type" not in found) < 3000
    assert [found["data-choices"] for _, found in scripts if "type" in found] == [
        "against-poses",
        "against-free_air",
        "against-clamped",
    ]


def test_colours_follow_the_scheme_of_the_reader_and_paper_is_light(page):
    """No colour stands in the page but in the two lists of the style sheet."""
    text = page.read_text(encoding="utf-8")
    rules = re.findall(r":root \{([^}]*)\}", text)
    defined = [set(re.findall(r"(--\w+): #", rule)) for rule in rules]
    assert "@media screen and (prefers-color-scheme: dark)" in text
    assert defined[0] == defined[1] >= {"--blue", "--page", "--ink", "--size5"}
    drawings = "".join(re.findall(r"<svg .*?</svg>", text, re.DOTALL))
    assert not re.findall(r"#[0-9a-fA-F]{3,6}\b", drawings)


def test_every_section(page):
    _, text = parse(page)
    heads = re.findall(r"<h2>(?:<small>)?(.*?)</(?:small|h2)>", page.read_text(encoding="utf-8"))
    numbered = [re.sub(r"^\d+\s+", "", head) for head in heads]
    assert [s for s in SECTIONS if s not in numbered] == []
    assert "KUKA KR20 R1810: calibration report" in text


def test_figures_hold_finite_numbers(page):
    assets, _ = parse(page)
    plots = drawings(page)
    for figure in plots.values():
        numbers = " ".join(value for node in figure.iter() for key, value in node.attrib.items() if key != "aria-label")
        assert "nan" not in numbers
        assert "inf" not in numbers
    assert {"rounds", "robot", "budget-poses", "stretch", "friction", "loops", "compliance", "fixture"} <= set(plots)
    assert {f"against-{s}" for s in ("poses", "free_air", "clamped")} <= set(plots)
    choices = [json.loads("".join(d)) for _, f, d in assets.scripts if "data-choices" in f]
    assert len(choices) == 3
    for choice in choices:
        assert len(choice["choices"]) > 8
        for variable in choice["choices"]:
            assert variable["below"]
            assert len(variable["over"]) == len(choice["values"])
            assert len(variable["x"]) in {1, len(choice["values"])}
            assert {len(x) for x in variable["x"]} == {len(y) for y in choice["values"]}


def test_every_axis_of_numbers_has_a_title_with_its_unit(page):
    """Axes of names (joints, effects, rounds) and categories go without."""
    for key, figure in drawings(page).items():
        texts = [node for node in figure.iter(f"{SVG}text") if node.get("class", "").startswith("middle")]
        up = [node.text for node in texts if "rotate" in node.get("transform", "")]
        flat = [node for node in texts if "rotate" not in node.get("transform", "")]
        along = [node.text for node in flat if float(node.get("y", "-1")) > 0]
        along = [text for text in along if not re.fullmatch(r"0|−?[\d.]+ ± [\d.]+", text)]  # numbers in cells
        assert up or key.startswith("budget") or key == "compliance", key
        assert along or key == "rounds", key
        assert [t for t in (*up, *along) if not UNIT.search(t)] == [], key


def test_the_verdict_is_reported(page, measured):
    campaign, _, model, _ = measured
    _, text = parse(page)
    assert "Joint 3's gear runs out & in." in text
    assert "more poses <of joint 3>" in text  # escaped, and read back
    assert "a1 = 123.4 ± 3.2 µrad" in text
    assert "base_tilt" in text
    assert campaign.fingerprint in text
    assert "--effects" in text
    assert "--seed 1" in text
    assert f"{len(model.sessions)}" in text


def test_what_is_not_known_is_said(page, measured):
    model = measured[2]
    assert not all(ok for stage in model.stages.values() for ok in stage.identified)
    _, text = parse(page)
    assert "not identifiable from these data" in text
    cells = page.read_text(encoding="utf-8").count('class="number open">not identifiable')
    told = [ok for stage in model.stages.values() for ok in (*stage.identified, *(p.known for p in stage.base))]
    assert cells == sum(not ok for ok in told)


def test_the_citations_follow_from_the_effects(page, measured):
    _, text = parse(page)
    assert "Nordin2002" in text
    assert "VisualInspection" not in text


def test_poses_alone(measured, tmp_path):
    """No torques, no diagnosis, and a campaign that the model never saw: less to say, and no failure."""
    made = measure(load_robot(ROBOT), seed=4, poses=25, tables=["poses"])
    write_campaign(tmp_path / "other", made.header, made.tables, "csv")
    other = read_campaign(tmp_path / "other")
    write_report(tmp_path / "own.html", identify(other), other)
    _, text = parse(tmp_path / "own.html")
    assert "The verdict and its evidence" not in text
    assert ">Torques<" not in (tmp_path / "own.html").read_text(encoding="utf-8")
    write_report(tmp_path / "foreign.html", measured[2], other)
    _, text = parse(tmp_path / "foreign.html")
    assert "not on this campaign, all rows of which are held out" in text


@pytest.mark.slow
def test_the_same_twice(measured, tmp_path):
    campaign, first, model, _ = measured
    for name in ("a.html", "b.html"):
        write_report(tmp_path / name, model, campaign, diagnosis=DIAGNOSIS, first_model=first)
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_a_failure_leaves_the_old_report(measured, tmp_path):
    path = tmp_path / "report.html"
    path.write_text("old")
    with pytest.raises(ValueError, match="could not convert"):
        write_report(
            path,
            measured[1],
            measured[0],
            diagnosis={"stages": {"poses": {"candidates": [candidate("backlash", ["joint1"], p_value="broken")]}}},
        )
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


def test_arm_points_end_at_the_flange():
    from clampid.report.robot3d import arm_points
    from kinematics.poe import forward

    robot = load_robot(ROBOT)
    q = np.random.default_rng(0).uniform(-1, 1, (5, robot.n))
    points = arm_points(robot, q)
    flange = forward(robot.screws, robot.flange, q @ np.asarray(robot.linkage).T)[:, :3, 3]
    np.testing.assert_allclose(points[:, -1], flange, atol=1e-12)
    assert points.shape == (5, robot.n + 2, 3)


def test_angle_errors_are_drawn_as_curves(tmp_path: Path):
    measured = measure(load_robot("ur10"), [Hidden("encoder_disc", None, 3.0)], seed=1, poses=50, tables=("poses",))
    write_campaign(tmp_path / "arm", measured.header, measured.tables)
    campaign = read_campaign(tmp_path / "arm")
    model = identify(campaign, ("geometry", "joint_angle_curve"), holdout=0.1)
    write_report(tmp_path / "report.html", model, campaign)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    curves = drawings(tmp_path / "report.html")["angles"]
    panels = [node for node in curves.iter() if node.get("class") == "panel"]
    titles = [[t.text for t in panel.iter(f"{SVG}text")] for panel in panels]
    assert [next(t for t in own if t and t.startswith("joint")) for own in titles] == [
        f"joint {j}" for j in range(1, 7)
    ]
    for panel in panels:
        assert [n for n in panel.iter(f"{SVG}path") if n.get("class") == "band blue"]
    assert "joint_angle_curve is drawn as curves" in text


def test_each_part_has_its_finding_as_its_heading(page):
    """A sentence with the number, not only the topic; the findings in full are folded."""
    text = page.read_text(encoding="utf-8")
    heads = dict(re.findall(r"<h2><small>\d+\s+(.*?)</small>(.*?)</h2>", text))
    for topic in ("The error, round by round", "The errors in space", "The model with standard errors", "Drives"):
        assert re.search(r"\d", heads[topic]), topic
    assert all(head.endswith(".") for head in heads.values())
    assert heads["The error, round by round"].startswith("The held-out error ")
    assert "<details><summary>The findings in full</summary>" in text
