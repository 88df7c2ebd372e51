"""An imported table that leaves a direction open: no number of it is printed, offered or exported.

The table is of an upright arm, so that its weight turns no joint with a vertical axis: the torque there comes out as
1e-16 Nm. A spring would need 1e14 rad/Nm to bend by what is left, and that number was once printed.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from cli_runner import Clampid

from clampid.models.model import load_model
from experiments.campaign import read_campaign
from experiments.simulate import simulate

LARGEST = 1e5  # no number of a robot in the units that are printed is larger: loads are N, inertias kg m²


def imported(folder: Path, clampid: Clampid) -> Path:
    """A campaign made by ``clampid import`` from a tracker's points, in mm and degrees, of an arm with soft drives."""
    campaign = read_campaign(simulate(folder / "simulated", seed=3, poses=40, tables=("poses",)))
    poses = campaign.tables["poses"]
    joints = range(1, campaign.robot.n + 1)
    table = pd.DataFrame({"P": poses["pose"], "T": poses["target"]})
    for j in joints:
        table[f"A{j}"] = np.degrees(poses[f"q{j}_rad"]).round(4)
    for axis in "xyz":
        table[axis.upper()] = (1e3 * poses[f"{axis}_m"]).round(3)
    table.to_csv(folder / "points.csv", index=False)
    columns = [f'q{j} = {{from = "A{j}"}}' for j in joints] + [
        f'{axis} = {{from = "{axis.upper()}"}}' for axis in "xyz"
    ]
    targets = ", ".join(f"{name} = {np.round(at, 5).tolist()}" for name, at in campaign.targets.items())
    mapping = [
        'format = "clampid-mapping/1"',
        'units = {angle = "deg", length = "mm"}',
        'table = "poses"',
        'files = "points.csv"',
        "[columns]",
        'pose = {from = "P"}',
        'visit = {number = "returns"}',
        'target = {from = "T"}',
        *columns,
        "[campaign]",
        f'robot = "{campaign.robot.name}"',
        "gravity_m_s2 = [0.0, 0.0, -9.81]",
        f"targets_m = {{{targets}}}",
        'instrument = {name = "laser tracker", range_std_m = 1e-5, angle_std_rad = 6e-6}',
    ]
    (folder / "mapping.toml").write_text("\n".join(mapping) + "\n")
    assert clampid("import", folder / "mapping.toml", "-o", folder / "arm", "-q").code == 0
    return folder / "arm"


def numbers(data: Any) -> list[float]:
    """Every number of a JSON value but counts."""
    if isinstance(data, dict):
        return [n for value in data.values() for n in numbers(value)]
    if isinstance(data, list):
        return [n for value in data for n in numbers(value)]
    return [data] if isinstance(data, float) else []


def printed(text: str) -> list[float]:
    """Every number on a screen."""
    return [
        float(n.replace("−", "-")) for n in re.findall(r"(?<![\w.])[-−]?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w.])", text)
    ]


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory, clampid: Clampid) -> tuple[Path, str, dict[str, Any]]:
    """The imported campaign, the long screen of its diagnosis, and the diagnosis for programs."""
    folder = tmp_path_factory.mktemp("imported")
    arm, model = imported(folder, clampid), folder / "m.json"
    assert clampid("identify", arm, "-o", model, "--effects", "geometry", "-q").code == 0
    ran = clampid("diagnose", model, arm, "--verbose", "-q", "--json", folder / "d.json")
    assert ran.code == 0, ran.err
    return folder, ran.out, json.loads((folder / "d.json").read_text())


def test_no_such_number_is_printed_or_in_the_json(found: tuple[Path, str, dict[str, Any]]) -> None:
    _, text, data = found
    assert max(map(abs, printed(text))) < LARGEST
    assert max(abs(n) for n in numbers(data["stages"]["poses"]["candidates"])) < LARGEST


def test_open_directions_are_marked_and_what_is_known_has_a_value(found: tuple[Path, str, dict[str, Any]]) -> None:
    """The springs that the weight does bend are offered with values; the others are not."""
    _, text, data = found
    springs = {
        p["name"]: p
        for c in data["stages"]["poses"]["candidates"]
        for p in c["parameters"]
        if p["name"].startswith("joint_compliance")
    }
    known = {name for name, p in springs.items() if p["identified"]}
    assert {"joint_compliance.c@joint2", "joint_compliance.c@joint3"} <= known
    upright = {"joint_compliance.c@joint1", "joint_compliance.c@joint4"} & set(springs)
    assert not upright & known
    for name in upright:
        assert springs[name]["value"] == pytest.approx(0.0, abs=1e-12)
        assert not re.search(rf"{re.escape(name)} +[-\d]", text)


@pytest.mark.slow
def test_nothing_of_it_is_exported(found: tuple[Path, str, dict[str, Any]], clampid: Clampid) -> None:
    """Springs are asked for by name: those that nothing bends stay near zero, and the table near the nominal one."""
    folder, _, _ = found
    model, arm, table = folder / "springs.json", folder / "arm", folder / "dh.csv"
    assert clampid("identify", arm, "-o", model, "--effects", "geometry,joint_compliance", "-q").code == 0
    values = {slot.label: value for slot, value in load_model(model).stages["poses"].values().items()}
    assert abs(values["joint_compliance.c@joint1"]) < 0.1
    ran = clampid("export", "dh", model, "--convention", "hayati", "-o", table)
    assert ran.code == 0, ran.err
    rows = pd.read_csv(table)
    lengths = rows[["d_m", "a_m"]].to_numpy(float)
    assert np.nanmax(np.abs(lengths)) < 3.0
    assert max(map(abs, printed(ran.out))) < LARGEST


def test_rounding_is_no_lever_of_a_candidate(found: tuple[Path, str, dict[str, Any]]) -> None:
    """A column that moves all rows by less than a millionth of the noise gives a candidate no freedom."""
    from clampid.catalogue import catalogue
    from clampid.evidence.candidates import named_candidates
    from clampid.evidence.score import score
    from clampid.evidence.space import space_of
    from clampid.identification.model_on_campaign import on_campaign

    folder, _, _ = found
    estimate = on_campaign(load_model(folder / "m.json"), read_campaign(folder / "arm")).refit("poses").estimate
    springs = {"joint_compliance": catalogue()["joint_compliance"]}
    scored = {s.candidate.label: s for s in score(space_of(estimate), named_candidates(estimate, springs))}
    assert scored["joint_compliance@joint1"].freedom == 0
    assert scored["joint_compliance@joint4"].freedom == 0
    assert scored["joint_compliance@joint2"].freedom == 1
    together = next(s for label, s in scored.items() if "," in label)
    assert np.abs(together.value).max() < 1.0
