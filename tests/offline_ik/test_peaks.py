"""The scattering point from peaks that a robot's detector found: the arm's own errors, tables, command and request."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from detector_sphere import detector_of, identified, measured_robot, true_poses
from ik_general import general
from typer.testing import CliRunner

from clampid.cli import app
from experiments.errors import CampaignError
from offline_ik.errors import TargetError
from offline_ik.inverse.detector import Detector
from offline_ik.reflections.peak_table import HC, read_peaks, wavelength_of
from offline_ik.reflections.peaks import Peak, _Stands, sample_from_peaks
from offline_ik.server.protocol import Session, Speaker
from offline_ik.verbs.sample import sample as sample_verb

SIGMA = 5e-5  # rad
PLACES = [(0.3, 0.2, 0.8), (0.5, 0.1, 0.8), (0.6, 0.5, 0.7), (0.2, 0.6, 0.8), (0.9, 0.3, 0.7), (0.4, 0.4, 0.7)]
SHIFT = np.array([3e-3, -2e-3, 1e-3])  # m, of the hidden sample from the cell's
CHI2_95_OF_3 = 7.814727903251179


def stood(detector: Detector) -> tuple[np.ndarray, np.ndarray]:
    """Postures that look at the sample ``(N, 6)``, and how the joints came there."""
    near, out = np.array([0.1, -1.2, 1.2, 0.1, 0.4, 0.0]), []
    for place in PLACES:
        first = detector.locate(*place, near=near, direction="moved").solutions[0]
        out.append((first.q, first.direction))
        near = first.q
    q, direction = zip(*out, strict=True)
    return np.array(q), np.array(direction)


def angle_at(points: np.ndarray, sample: np.ndarray, beam: tuple[float, float, float]) -> np.ndarray:
    """The scattering angle of rays from the sample to points ``(N, 3)``, rad."""
    v = points - sample
    return np.arccos(v @ np.array(beam) / np.linalg.norm(v, axis=1))


def test_a_hidden_arm_of_the_models_covariance_is_covered(detector: Detector) -> None:
    """Arms are drawn from the model's covariance and predicted by clampid's own code, not by the detector's."""
    rng, cell, arm = np.random.default_rng(0), detector.cell, detector.arm
    q, direction = stood(detector)
    # One side for all: the general prediction takes one.
    side, offset = direction[0], np.array([0.02, -0.03])
    given = replace(detector.still, direction=side)
    C = detector.propagation.covariance
    values, vectors = np.linalg.eigh(C)
    root, sample = vectors * np.sqrt(np.maximum(values, 0.0)), np.add(cell.convention.sample, SHIFT)
    at = detector.solver.mount[:3, 3] + detector.solver.mount[:3, :2] @ offset
    back = np.linalg.inv(arm.base)
    off, chi = [], []
    for _ in range(80):
        hidden = arm.with_theta(arm.theta + root @ rng.normal(size=len(C)))
        point = general(hidden, q, given, at)[0] @ back[:3, :3].T + back[:3, 3]
        angles = angle_at(point, sample, cell.convention.beam) + SIGMA * rng.normal(size=len(q))
        peaks = [Peak(a, SIGMA, one, direction=side, offset=offset) for a, one in zip(angles, q, strict=True)]
        found = sample_from_peaks(detector, peaks).position
        off.append((found.sample - sample) @ np.linalg.solve(found.covariance, found.sample - sample))
        chi.append(found.chi_square)
    assert np.mean(np.array(off) < CHI2_95_OF_3) > 0.876  # 0.95 less three standard errors of 80 draws
    assert np.mean(off) == pytest.approx(3.0, abs=0.82)  # three standard errors
    assert np.mean(chi) == pytest.approx(3.0, abs=0.82)


@pytest.mark.slow
def test_points_follow_the_parameters_far_from_the_detectors_middle_too(detector: Detector) -> None:
    """Their covariance is that of clampid's own prediction, differentiated numerically: turns included."""
    arm, (q, direction) = detector.arm, stood(detector)
    offset = np.array([0.6, -0.8])
    stands = _Stands(detector, None, 0.0)
    rows = [stands.of(k, Peak(0.3, SIGMA, q[k], direction=direction[0])) for k in range(2)]
    _, covariance = stands.points(rows, np.tile(offset, (2, 1)), [0.0, 0.0])
    C = detector.propagation.covariance
    values, vectors = np.linalg.eigh(C)
    root, back = vectors * np.sqrt(np.maximum(values, 0.0)), np.linalg.inv(arm.base)[:3, :3]
    given = replace(detector.still, direction=direction[0])
    at = detector.solver.mount[:3, 3] + detector.solver.mount[:3, :2] @ offset
    moved = []
    for column in 1e-2 * root.T:
        up, down = (general(arm.with_theta(arm.theta + s * column), q[:2], given, at)[0] for s in (1.0, -1.0))
        moved.append((up - down).reshape(-1, 3) @ back.T / 2e-2)
    expected = sum(np.outer(m.ravel(), m.ravel()) for m in moved)
    assert np.allclose(covariance, expected, rtol=1e-2, atol=1e-2 * np.abs(expected).max())


def test_what_is_not_known_of_a_posture_widens_it(detector: Detector) -> None:
    q, direction = stood(detector)
    angles = angle_at(
        detector.pose(q)[:, :3, 3], np.array(detector.cell.convention.sample), detector.cell.convention.beam
    )
    known = [Peak(a, SIGMA, one, direction=d) for a, one, d in zip(angles, q, direction, strict=True)]
    sure, open_ = (
        sample_from_peaks(detector, known),
        sample_from_peaks(detector, [replace(k, direction=None) for k in known]),
    )
    loose = sample_from_peaks(detector, known, repeatability=1e-4)
    assert (open_.std > sure.std).all()
    assert (loose.std > sure.std).all()
    assert any("from which side joints came is not known" in note for note in open_.notes)
    assert any("own repeatability is not in" in note for note in sure.notes)
    assert not any("own repeatability is not in" in note for note in loose.notes)


def test_asked_places_and_joint_angles_say_the_same(detector: Detector) -> None:
    q = np.array([detector.locate(*place, near=np.zeros(6)).solutions[0].q for place in PLACES])
    sample = np.add(detector.cell.convention.sample, SHIFT)
    angles = angle_at(detector.pose(q)[:, :3, 3], sample, detector.cell.convention.beam)
    by_q = sample_from_peaks(detector, [Peak(a, SIGMA, one) for a, one in zip(angles, q, strict=True)])
    asked = [Peak(a, SIGMA, place=(*place, 0.0)) for a, place in zip(angles, PLACES, strict=True)]
    by_place = sample_from_peaks(detector, asked, near=np.zeros(6))
    assert np.allclose(by_q.position.sample, sample, atol=1e-8)
    assert np.allclose(by_place.position.sample, sample, atol=1e-8)
    assert np.allclose(by_q.shift, detector.cell.convention.lab.T @ SHIFT, atol=1e-8)
    assert by_place.cell_lines[1] == "sample_m = [1.4030000, -0.0020000, 0.0010000]"
    with pytest.raises(TargetError, match=r"reflection 1: gamma 0\.3, delta 0\.2, r 3 cannot be reached"):
        sample_from_peaks(detector, [replace(asked[0], place=(0.3, 0.2, 3.0, 0.0)), *asked[1:]])


@pytest.mark.slow
def test_the_hidden_sample_before_the_virtual_robot() -> None:
    """The robot's own physics say where the detector stood; the model was identified from its campaign."""
    measured, campaign = measured_robot(0)
    detector = detector_of(identified(campaign), campaign)
    sample = np.asarray(detector.cell.convention.sample) + SHIFT
    rng, near, q, direction = np.random.default_rng(1), detector.rest + 0.1, [], []
    for gamma, delta in rng.uniform(0.1, 1.3, (12, 2)).tolist():
        answer = detector.locate(gamma, delta, 0.8, near=near, direction="moved")
        if answer.reachable:
            near = answer.solutions[0].q
            q.append(near)
            direction.append(answer.solutions[0].direction)
    assert len(q) >= 8
    assert detector.cell.link_temperature is not None
    there = true_poses(measured, np.array(q), np.array(direction), detector.cell.link_temperature)
    angles = angle_at(there[:, :3, 3], sample, detector.cell.convention.beam) + SIGMA * rng.normal(size=len(q))
    peaks = [Peak(a, SIGMA, one, direction=way) for a, one, way in zip(angles, q, direction, strict=True)]
    found = sample_from_peaks(detector, peaks).position
    off = found.sample - sample
    assert found.fits
    assert off @ np.linalg.solve(found.covariance, off) < 16.27  # exceeded by one in a thousand
    assert np.linalg.norm(off) < 2e-4
    assert np.linalg.norm(off) < 0.1 * np.linalg.norm(SHIFT)


HEAD = "q1_rad,q2_rad,q3_rad,q4_rad,q5_rad,q6_rad,x_pixels,y_pixels,spacing_angstrom,std_two_theta_rad,std_pixels,name"
KEV = 20.0


@pytest.fixture(scope="module")
def table(detector: Detector) -> list[list[str]]:
    """Rows of a table of spacings, of peaks beside the detector's middle."""
    q, _ = stood(detector)
    xy = np.random.default_rng(2).uniform(-0.02, 0.02, (len(q), 2))
    pose = detector.pose(q)
    points = pose[:, :3, 3] + np.einsum("nij,nj->ni", pose[:, :3, :2], xy)
    angles = angle_at(points, np.add(detector.cell.convention.sample, SHIFT), detector.cell.convention.beam)
    spacings = HC / KEV / 2 / np.sin(angles / 2)
    return [
        [*map("{:.10f}".format, one), *(f"{v / 55e-6:.6f}" for v in at), f"{d:.10f}", "5e-5", "0.3", f"ring {k}"]
        for k, (one, at, d) in enumerate(zip(q, xy, spacings, strict=True))
    ]


def written(path: Path, rows: list[list[str]], head: str = HEAD) -> Path:
    path.write_text("\n".join([head, *(",".join(row) for row in rows)]) + "\n", encoding="utf-8")
    return path


def test_a_table_of_spacings_and_pixels_finds_the_sample(
    detector: Detector, table: list[list[str]], tmp_path: Path
) -> None:
    peaks = read_peaks(written(tmp_path / "peaks.csv", table), 6, 55e-6, wavelength_of(energy=KEV))
    found = sample_from_peaks(detector, peaks)
    assert np.allclose(found.position.sample, np.add(detector.cell.convention.sample, SHIFT), atol=2e-8)
    assert found.names[2] == "ring 2"
    # an offset taken for the other axis' is off by more
    turned = sample_from_peaks(detector, [replace(p, offset=p.offset[::-1]) for p in peaks])
    assert np.abs(turned.position.sample - found.position.sample).max() > 1e-3


Change = Callable[[list[list[str]]], None]


def cell(row: int, column: int, value: str) -> Change:
    def change(rows: list[list[str]]) -> None:
        rows[row][column] = value

    return change


@pytest.mark.parametrize(
    ("change", "head", "energy", "says"),
    [
        (cell(3, 8, "0.2"), HEAD, 20.0, "row 4 (line 5), column spacing_angstrom: expected a spacing above half"),
        (cell(3, 8, "nan"), HEAD, 20.0, "row 4 (line 5), column spacing_angstrom: expected a finite number"),
        (cell(1, 9, "0"), HEAD, 20.0, "reflection 2: expected a positive standard error"),
        (cell(1, 6, "1e6"), HEAD, 20.0, "reflection 2: expected a peak within 1 m"),
        (cell(2, 1, "-95"), HEAD, 20.0, "reflection 3: q: expected joint angles in radians"),
        (cell(2, 1, "3.0"), HEAD, 20.0, "reflection 3: q: expected A2 from -3.229 to 1.134 rad"),
        (lambda rows: rows.__delitem__(slice(2, None)), HEAD, 20.0, "expected at least three reflections, found 2"),
        (
            lambda rows: rows.__setitem__(slice(None), [[*rows[0][:11], str(k)] for k in range(4)]),
            HEAD,
            20.0,
            "too much",
        ),
        (lambda rows: rows.append(rows[1]), HEAD, 20.0, "row 7 (line 8): expected every reflection once, found row 2"),
        (cell(0, 0, "0.1"), HEAD.replace("q1_rad", "q1_deg"), 20.0, "'q1_deg'"),
        (cell(0, 0, "0.1"), HEAD.replace("std_pixels", "std_px"), 20.0, "column std_px: expected columns of"),
        (cell(0, 0, "0.1"), HEAD.replace("spacing_angstrom", "d"), 20.0, "two_theta_rad or spacing_angstrom"),
        (cell(0, 8, "30"), HEAD.replace("spacing_angstrom", "two_theta_rad"), None, "did you mean 30 degrees"),
        (cell(0, 8, "1"), HEAD.replace("spacing_angstrom", "two_theta_rad"), 20.0, "with two_theta_rad"),
        (cell(0, 0, "0.1"), HEAD, None, "need the energy or the wavelength"),
        (cell(0, 0, "0.1"), HEAD, 20000.0, "did you mean 20000 eV"),
    ],
)
def test_a_table_that_cannot_be_meant_is_refused(
    detector: Detector,
    table: list[list[str]],
    tmp_path: Path,
    change: Change,
    head: str,
    energy: float | None,
    says: str,
) -> None:
    rows = [list(row) for row in table]
    change(rows)
    with pytest.raises((CampaignError, TargetError)) as caught:
        sample_from_peaks(
            detector, read_peaks(written(tmp_path / "p.csv", rows, head), 6, 55e-6, wavelength_of(energy))
        )
    assert says in str(caught.value)


def test_a_wavelength_in_metres_is_asked_about() -> None:
    with pytest.raises(TargetError, match=r"did you mean 1\.54e-10 m"):
        wavelength_of(wavelength=1.54e-10)
    with pytest.raises(TargetError, match="found both"):
        wavelength_of(20.0, 0.6)
    assert wavelength_of(energy=8.04778) == pytest.approx(1.54060, abs=1e-4)  # Cu K-alpha 1


def test_the_command_prints_the_point_and_the_lines_of_the_cell(
    model_file: Path, cell_file: Path, table: list[list[str]], tmp_path: Path
) -> None:
    table = [list(row) for row in table]
    table[2][8] = f"{0.999 * float(table[2][8]):.8f}"
    peaks, out = written(tmp_path / "peaks.csv", table), tmp_path / "sample.json"
    assert sample_verb.__doc__
    given = ["sample", str(model_file), str(peaks), "--cell", str(cell_file)]
    done = CliRunner().invoke(app(), [*given, "--energy", "20", "--json", str(out)])
    assert done.exit_code == 0, done.output
    assert "ring 2 does not fit" in " ".join(done.output.split())
    assert "sample_m = [" in done.output
    data = json.loads(out.read_text(encoding="utf-8"))
    assert data["suspects"] == [3]
    assert data["fits"] is False
    assert data["reflections"][2]["name"] == "ring 2"
    wrong = CliRunner().invoke(app(), given)
    assert wrong.exit_code != 0
    assert isinstance(wrong.exception, TargetError)
    assert str(peaks) in str(wrong.exception)


def test_a_request_says_what_the_table_says(detector: Detector, table: list[list[str]]) -> None:
    speaker = Speaker(detector)
    lists = list(zip(*table, strict=True))
    q = ",".join(v for row in table for v in row[:6])
    x, y = (",".join(f"{55e-6 * float(v):.10f}" for v in column) for column in lists[6:8])
    spacing = ",".join(f"{1e-10 * float(v):.18f}" for v in lists[8])
    line = f"sample q={q} x={x} y={y} spacing={spacing} wavelength={1e-10 * HC / KEV} std=5e-5 std_xy=1.65e-5"
    assert len(line) < 4096
    found = json.loads(speaker.answer(line.encode(), Session(greeted=True)))
    assert found["ok"], found
    assert np.allclose(found["sample_m"], np.add(detector.cell.convention.sample, SHIFT), atol=2e-8)
    assert found["degrees_of_freedom"] == 3
    for wrong, says in (
        (line + " gamma=0.1", "found q= with gamma="),
        (line + " two_theta=0.1", "expected two_theta=t1,t2"),
        (line.replace("std=5e-5", "std=5e-5,5e-5"), "expected std= with 6 numbers, found 2"),
        (line.replace("std=5e-5 ", ""), "expected std= with 6 numbers"),
        (line.replace(f"wavelength={1e-10 * HC / KEV}", "wavelength=1e-9"), "reflection 1: a spacing of"),
        ("sample two_theta=30,40,50 gamma=0.1,0.2,0.3 delta=0 r=0.8 std=5e-5", "did you mean 30 degrees"),
        ("sample two_theta=nan,0.4,0.5 gamma=0.1,0.2,0.3 delta=0 r=0.8 std=5e-5", "found nan"),
        ("sample two_theta=0.3,0.4,0.5 gamma=30,0.2,0.3 delta=0 r=0.8 std=5e-5", "did you mean 30 degrees"),
    ):
        refused = json.loads(speaker.answer(wrong.encode(), Session(greeted=True)))
        assert refused["ok"] is False
        assert says in refused["error"], refused["error"]
