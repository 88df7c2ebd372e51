"""What moves nothing: simulations with a picture, what a pixel sees, and frames as a controller writes them."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from memory_link import START, MemoryLink
from scipy.spatial.transform import Rotation
from serving_thread import Serving

from kinematics.poe import forward
from offline_ik.cell.cell import read_cell
from offline_ik.cell.coordinates import detector_angles, detector_pose
from offline_ik.cell.frames import kuka_frame
from offline_ik.collision.safety import check_path
from offline_ik.errors import CellError, TargetError
from offline_ik.inverse.detector import Detector
from offline_ik.motion.picture import picture_of
from offline_ik.motion.simulation import Position, simulate_move, simulate_straight
from offline_ik.reflections.seen import pixel_of, poni_text
from offline_ik.server.protocol import Session, Speaker

PIXELS = (514, 1030)


def ask(speaker: Speaker, line: str) -> dict[str, object]:
    found: dict[str, object] = json.loads(speaker.answer(line.encode(), Session(greeted=True)))
    return found


@pytest.mark.parametrize(
    "target", ["gamma=0.35 delta=0.2 r=0.8", "gamma=0.3 delta=0.2 r=3", "gamma=0.2 delta=-1.2 r=0.5"]
)
def test_simulate_says_what_move_does(target: str, detector: Detector) -> None:
    link = MemoryLink(seconds=0.0)
    speaker = Speaker(detector, link)
    simulated = ask(speaker, f"simulate {target}")
    assert not link.sent
    moved = ask(speaker, f"move {target}")
    assert simulated["would_move"] is moved["moving"] is bool(link.sent)
    for member in ("reachable", "reasons", "path", "solutions", "nearest", "direction_from"):
        assert simulated.get(member) == moved.get(member)
    if link.sent:
        track = simulated["track"]
        assert np.allclose(track[0]["q_rad"], START)  # type: ignore[index]
        assert np.allclose(track[-1]["q_rad"], link.sent[0][-1])  # type: ignore[index]
        assert track[-1]["t_s"] == pytest.approx(moved["path"]["duration_s"])  # type: ignore[index]


def test_simulate_asks_the_same_check_as_move(detector: Detector, monkeypatch: pytest.MonkeyPatch) -> None:
    def refusing(*given: object) -> object:
        return replace(check_path(*given), reasons=("patched",))  # type: ignore[arg-type]

    monkeypatch.setattr("offline_ik.motion.ways.check_path", refusing)
    link = MemoryLink()
    speaker = Speaker(detector, link)
    assert ask(speaker, "simulate gamma=0.35 delta=0.2 r=0.8")["would_move"] is False
    assert ask(speaker, "move gamma=0.35 delta=0.2 r=0.8")["moving"] is False
    assert "patched" in speaker.robot.refusal  # type: ignore[union-attr]
    assert not link.sent


def test_clearances_are_not_below_what_the_check_found(detector: Detector) -> None:
    found = simulate_move(detector, Position(0.35, 0.2, 0.8), start=START)
    assert found.way is not None
    clearances = found.clearances(200)
    assert clearances[0].distance == pytest.approx(found.way.path.clearance, abs=2e-3)
    assert [c.distance for c in clearances] == sorted(c.distance for c in clearances)


def test_the_picture_is_an_svg_that_shows_every_body(detector: Detector) -> None:
    cell = replace(detector.cell, obstacles=tuple(replace(o, name="<stage & co>") for o in detector.cell.obstacles))
    named = detector.within(cell)
    found = simulate_move(named, Position(0.35, 0.2, 0.8), start=START)
    root = ElementTree.fromstring(picture_of(found))
    space = "{http://www.w3.org/2000/svg}"
    titles = [t.text for t in root.iter(f"{space}title")]
    assert "<stage & co>" in titles
    assert {"base", "detector", "sample"} <= set(titles)
    (line, above) = root.iter(f"{space}polyline")
    assert len(line.get("points", "").split()) == len(above.get("points", "").split()) == 25
    numbers = [
        float(v) for p in root.iter(f"{space}polygon") for xy in p.get("points", "").split() for v in xy.split(",")
    ]
    assert all(math.isfinite(v) and -1 < v < 921 for v in numbers)
    refused = simulate_move(named, Position(0.3, 0.2, 3.0), start=START)
    assert "not reachable" in picture_of(refused)


def test_frames_are_those_of_the_arm_and_of_the_controller(detector: Detector) -> None:
    robot = detector.robot
    told = ask(Speaker(detector), "where gamma=0.35 delta=0.2 r=0.8")["solutions"][0]  # type: ignore[index]
    q = np.array(told["q_rad"])
    for name, pose in (
        ("controller_flange", forward(robot.screws, robot.flange, q)),
        ("detector", detector.to_base(detector.pose(q[None])[0])),
    ):
        frame = told[name]
        turned = Rotation.from_euler("ZYX", [frame[k] for k in ("A_deg", "B_deg", "C_deg")], degrees=True).as_matrix()
        assert np.allclose(
            [frame[k] for k in ("X_mm", "Y_mm", "Z_mm")], 1e3 * pose[:3, 3], atol=2e-1 if name == "detector" else 1e-9
        )
        assert np.allclose(turned, pose[:3, :3], atol=1e-3)
    apart = [told["flange"][k] - told["controller_flange"][k] for k in ("X_mm", "Y_mm", "Z_mm")]
    assert 0.1 < np.linalg.norm(apart) < 30  # what the identified arm knows and the controller does not


@pytest.mark.parametrize("abc", [(10, 20, 30), (170, -80, -100), (0, 90, 37), (0, -90, 25), (180, 0, 0)])
def test_kuka_angles(abc: tuple[float, float, float]) -> None:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("ZYX", abc, degrees=True).as_matrix()
    found = kuka_frame(pose)
    back = Rotation.from_euler("ZYX", [found[k] for k in ("A_deg", "B_deg", "C_deg")], degrees=True).as_matrix()
    assert np.allclose(back, pose[:3, :3], atol=1e-12)
    assert found["B_deg"] == pytest.approx(abc[1])


@pytest.mark.parametrize(("i", "j"), [(256.5, 514.5), (0, 0), (513, 1029), (17, 900)])
@pytest.mark.parametrize("roll", [0.0, 0.4])
def test_what_a_pixel_sees_is_what_pyfai_says(
    i: float, j: float, roll: float, detector: Detector, tmp_path: Path
) -> None:
    pyfai = pytest.importorskip("pyFAI.integrator.azimuthal")
    import pyFAI

    answer = detector.locate(0.6, 0.3, 0.8, roll)
    seen = pixel_of(detector, answer.target, answer.solutions[0].uncertainty.covariance, (i, j), PIXELS)
    file = tmp_path / "detector.poni"
    file.write_text(poni_text(detector.cell.convention, answer.target, detector.cell.pixel, PIXELS, 1e-10))
    geometry = pyFAI.load(str(file))
    assert isinstance(geometry, pyfai.AzimuthalIntegrator)
    assert geometry.wavelength == 1e-10
    assert geometry.detector.max_shape == PIXELS
    at = geometry.tth(np.array([i]), np.array([j]))[0]
    assert seen.two_theta == pytest.approx(float(at), abs=1e-9)
    z, y, x = (float(v[0]) for v in geometry.calc_pos_zyx(corners=False, d1=np.array([i]), d2=np.array([j])))
    convention = detector.cell.convention
    place = np.eye(4)  # pyFAI: z along the beam, y up, x against up x beam
    place[:3, 3] = np.asarray(convention.sample) + convention.lab @ np.array([-x, y, z])
    angles = detector_angles(convention, place)
    assert (seen.gamma, seen.delta) == pytest.approx((angles.gamma, angles.delta), abs=1e-9)


@pytest.mark.parametrize("order", ["gamma_outer", "delta_outer"])
def test_the_uncertainty_of_a_pixel_is_that_of_poses_drawn(order: str, detector: Detector) -> None:
    cell = replace(detector.cell, convention=replace(detector.cell.convention, order=order))
    own, target = detector.within(cell), detector_pose(cell.convention, 0.5, 0.4, 0.8)
    covariance = detector.locate(0.5, 0.4, 0.8).solutions[0].uncertainty.covariance
    seen = pixel_of(own, target, covariance, (0, 1029), PIXELS)
    axes = own.towards(own.to_base(target), 0.0)
    rng = np.random.default_rng(0)
    drawn = rng.multivariate_normal(np.zeros(6), covariance, 1000)
    found = []
    for step in drawn:
        pose = target.copy()
        turned = Rotation.from_rotvec(axes @ step[3:]).as_matrix()
        pose[:3, :3] = turned @ pose[:3, :3]
        pose[:3, 3] += axes @ step[:3]
        at = pixel_of(own, pose, covariance, (0, 1029), PIXELS)
        found.append((at.gamma, at.delta, at.distance, at.two_theta))
    stds = np.std(found, axis=0)
    told = (seen.spread.gamma, seen.spread.delta, seen.spread.r, seen.two_theta_std)
    assert np.allclose(told, stds, rtol=0.12)


def test_pixel_over_the_line_protocol(serving: Serving) -> None:
    with serving.client() as one:
        middle = one.ask("pixel i=256.5 j=514.5 gamma=0.35 delta=0.2 r=0.8 poni=yes wavelength=1e-10")
        assert middle["sees"]["gamma_rad"] == pytest.approx(0.35, abs=1e-9)
        assert middle["sees"]["delta_rad"] == pytest.approx(0.2, abs=1e-9)
        assert "Wavelength: 1e-10" in middle["poni"]
        here = one.ask("pixel i=0 j=0")  # where the linked robot is
        assert here["q_rad"] == list(START)
        assert one.ask("pixel i=0 j=0 gamma=0.3 delta=0.2 r=3")["reachable"] is False
        for line, says in (
            ("pixel i=514 j=0", "i: expected a pixel from 0 to 513"),
            ("pixel i=0 j=nan", "j: expected a pixel"),
            ("pixel i=0 j=0 pixels=0,5", "pixels: expected ROWS,COLUMNS"),
            ("pixel i=0 j=0 pixels=nan,5", "pixels: expected ROWS,COLUMNS"),
            ("pixel i=0 j=0 wavelength=1.5", "wavelength: expected metres"),
            ("pixel i=0 j=0 q=0,0,0,0,0,0 r=0.8", "found q= with r="),
            ("pixel i=0 j=0 gamma=0.3", "expected delta=NUMBER"),
        ):
            assert says in one.ask(line)["error"]


def test_pixels_must_be_said(detector: Detector, cell_file: Path, tmp_path: Path) -> None:
    none = detector.within(replace(detector.cell, pixels=None))
    assert "pixels=ROWS,COLUMNS" in str(ask(Speaker(none), "pixel i=0 j=0 q=0.1,-1.2,1.2,0.1,0.4,0")["error"])
    assert detector.cell.pixels == PIXELS
    wrong = tmp_path / "cell.toml"
    wrong.write_text(cell_file.read_text().replace("[514, 1030]", "[514.5, 1030]"))
    with pytest.raises(CellError, match="two whole numbers"):
        read_cell(wrong, detector.robot)
    with pytest.raises(TargetError):
        pixel_of(detector, np.eye(4), np.eye(6), (-1, 0), PIXELS)


def test_a_straight_move_checked_at_once_is_the_one_that_a_search_finds(detector: Detector) -> None:
    rng, at_once, searched = np.random.default_rng(11), 0, 0
    for _ in range(40):
        gamma, delta, r = rng.uniform([0.1, 0.0, 0.6], [0.6, 0.5, 0.9])
        start = np.array(START) + rng.normal(size=6) * 0.2
        answer = detector.at_once(gamma, delta, r, near=start, direction="moved")
        brief = None if answer is None else simulate_straight(detector, answer, start)
        whole = simulate_move(detector, Position(gamma, delta, r), start=start)
        if brief is None:
            searched += 1
            continue
        at_once += 1
        assert brief.safe
        assert whole.safe
        assert np.array_equal(brief.postures, whole.postures)
        assert brief.to_json() == whole.to_json()
    assert at_once > 5
    assert searched > 0
