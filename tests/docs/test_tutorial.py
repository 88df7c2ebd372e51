"""The tutorial's mapping of public measurements reads a file that is laid out as the public one."""

from __future__ import annotations

import re
import runpy
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments.campaign import read_campaign
from kinematics import load_robot
from kinematics.poe import forward

TUTORIAL = Path(__file__).parents[2] / "docs" / "tutorial" / "the-loop.md"
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
MEASURED = ("x", "std_x", "y", "std_y", "z", "std_z", "rx", "std_rx", "ry", "std_ry", "rz", "std_rz")


def test_the_mapping_of_the_public_file_gives_poses_in_si(program: Path, tmp_path: Path) -> None:
    mapping = re.search(
        r"<!-- file: (ur10\.toml) -->\n```toml\n(.*?)```", TUTORIAL.read_text(encoding="utf-8"), re.DOTALL
    )
    assert mapping is not None
    (tmp_path / mapping[1]).write_text(mapping[2], encoding="utf-8")
    rng = np.random.default_rng(3)
    robot, q = load_robot("ur10"), rng.uniform(-2.0, 2.0, (40, 6)).round(6)
    base = np.eye(4)
    base[:3, :3], base[:3, 3] = Rotation.random(random_state=1).as_matrix(), [2.5, -1.0, 0.3]
    poses = base @ forward(robot.screws, robot.flange, q)
    names = ("Timestamp", *(f"{joint}_joint" for joint in JOINTS), "measurement_temperature")
    rows = [";".join((*names, *(f"measurement_{name}" for name in MEASURED)))]
    for angles, pose in zip(q, poses, strict=True):
        mm, degrees = 1e3 * pose[:3, 3], Rotation.from_matrix(pose[:3, :3]).as_euler("XYZ", degrees=True)
        numbers = [2.02103e13, *angles, 20.7, *(n for value in (*mm, *degrees) for n in (value, 0.001))]
        rows.append(";".join(f"{number:.10g}".replace(".", ",") for number in numbers))
    (tmp_path / "measurements_iso_cubes.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    words = [program, "import", "ur10.toml", "-o", "ur10_series_d"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    table = read_campaign(tmp_path / "ur10_series_d").tables["poses"]
    np.testing.assert_allclose(table[[f"q{k}_rad" for k in range(1, 7)]], q, atol=1e-9)
    np.testing.assert_allclose(table[["x_m", "y_m", "z_m"]], poses[:, :3, 3], atol=1e-8)
    turns = Rotation.from_quat(table[["qx", "qy", "qz", "qw"]].to_numpy())
    difference = (turns.inv() * Rotation.from_matrix(poses[:, :3, :3])).magnitude()
    assert difference.max() < 1e-7


@pytest.mark.slow
def test_the_notebook_runs_and_acts_on_its_own_verdict(capsys) -> None:
    """Poses alone leave two explanations; the notebook adds neither, measures what decides, and then finds the one."""
    found = runpy.run_path(str(TUTORIAL.with_name("the_loop.py")))
    printed = capsys.readouterr().out
    assert found["poses"].verdict == "ambiguous"
    assert {"gear_eccentricity", "gravity_compensator"} <= set(found["alternatives"])
    assert not any("gear_eccentricity" in term or "gravity_compensator" in term for term in found["confirmed"])
    assert "These data do not distinguish gear_eccentricity and gravity_compensator." in printed
    assert "gear_eccentricity@joint3" in {term.label for term in found["mended"].stages["poses"].terms}
    assert found["diagnosis"].stages["poses"].verdict == "missing"
