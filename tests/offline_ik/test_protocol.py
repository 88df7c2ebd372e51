"""The line protocol without a socket: answers, refusals that change nothing, and the seam for a robot."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ik_arms import drawn_arm

from offline_ik.collision.safety import check_path
from offline_ik.inverse.detector import Detector
from offline_ik.server.protocol import WORDS, Session, Speaker

START = (0.1, -1.2, 1.2, 0.1, 0.4, 0.0)
GOOD = b"where gamma=0.3 delta=0.2 r=0.8"


def say(speaker: Speaker, line: bytes | str, session: Session | None = None) -> dict[str, Any]:
    found = speaker.answer(line.encode() if isinstance(line, str) else line, session or Session(greeted=True))
    assert found.endswith(b"\n")
    assert found.count(b"\n") == 1
    answer: dict[str, Any] = json.loads(found)
    return answer


@pytest.fixture
def speaker(detector: Detector) -> Speaker:
    return Speaker(detector)


def test_a_position_is_answered_with_angles_uncertainty_and_convention(speaker: Speaker, detector: Detector) -> None:
    found = say(speaker, GOOD + b" id=a17")
    assert found["ok"] is True
    assert found["id"] == "a17"
    direct = detector.locate(0.3, 0.2, 0.8).solutions[0]
    told = found["solutions"][0]
    assert np.allclose(told["q_rad"], direct.q, atol=1e-11)
    assert np.allclose(told["motor_rad"], direct.motor, rtol=1e-11)
    assert told["std_m"] == pytest.approx(direct.uncertainty.std_m, rel=1e-5)
    assert told["tangential_std_pixels"] == pytest.approx(direct.uncertainty.tangential_m / 55e-6, rel=1e-5)
    assert found["convention"]["sample_m"] == [1.4, 0.0, 0.0]


def test_approach_and_pyfai_are_given_where_asked_for(speaker: Speaker) -> None:
    found = say(speaker, GOOD + b" approach=yes pyfai=yes")
    assert found["approach"]["gain_m"] > 0
    assert found["pyfai"]["dist"] == pytest.approx(0.8, abs=1e-9)


def test_out_of_reach_is_an_answer_and_no_error(speaker: Speaker) -> None:
    found = say(speaker, "where gamma=0.3 delta=0.2 r=3")
    assert found["ok"] is True
    assert found["reachable"] is False
    assert found["solutions"] == []
    assert found["nearest"]["distance_m"] > 0.1


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (b"", "empty line"),
        (b"fetch", "no request is called 'fetch'"),
        (b"where", "expected gamma=NUMBER"),
        (b"where gamma=0.3 delta=0.2", "expected r=NUMBER"),
        (b"where gamma=30 delta=0.2 r=0.8", "did you mean 30 degrees"),
        (b"where gamma=0.3 delta=0.2 r=800", "did you mean 800 mm"),
        (b"where gamma=nan delta=0.2 r=0.8", "finite"),
        (b"where gamma=x delta=0.2 r=0.8", "expected a number, found 'x'"),
        (b"where gamma=0.3 delta=0.2 r=0_8", "expected a number, found '0_8'"),
        (b"where gamma=0.3 delta=0.2 r=1e308", "at most 10, found 1e+308"),
        (b"where gamma=0.3 delta=0.2 r=-0.8", "positive distance"),
        (b"where gamma=0.3 delta=0.2 r=0.8 near=0,-1_2,1,0,0,0", "separated by commas"),
        (b"stream gamma=0.3 delta=0.2 r=0.8", "expected a posture to start from"),
        (b"where gamma=0.3 delta=0.2 r=0.8 r=0.9", "twice"),
        (b"where gamma=0.3 delta=0.2 r=0.8 colour=red", "no key is called 'colour'"),
        (b"where gamma 0.3", "expected key=value"),
        (b"where gamma=0.3 delta=0.2 r=0.8 near=1,2", "expected 6 joint angles"),
        (b"where gamma=0.3 delta=0.2 r=0.8 branch=best", "expected nearest, all"),
        (b"where gamma=0.3 delta=0.2 r=0.8 approach=maybe", "expected yes or no"),
        (b"path gamma=0.3 delta=0.2 r=0.8", "expected a posture to start from"),
        (b"path gamma=0.3 delta=0.2 r=0.8 approach=maybe from=0,0,0,0,0,0", "expected yes or no"),
        (b"path to=0,0,0,0,0,0 from=0,0,0,0,0,0 gamma=0.3", "found to= with gamma="),
        (b"start", "expected q="),
        (b"at", "expected a posture"),
        (b"at q=1,2", "expected 6 joint angles"),
        (b"at q=nan,0,0,0,0,0", "finite"),
        (b"at q=0,-90,90,0,0,0", "degrees"),
        (b"stop", "no robot is linked"),
        (b"temperature", "expected link="),
        (b"temperature link=1,2", "expected 6 temperatures"),
        (b"temperature link=1,2,3,4,5,900", "expected 6 temperatures"),
        (b"temperature link=nan,2,3,4,5,6", "expected 6 temperatures"),
        (b"stream gamma=0.3 delta=0.2 r=0.8 dt=-1", "expected a time"),
        (b"move gamma=0.3 delta=0.2 r=0.8", "only computes"),
        (b"\xff\xfe", "ASCII"),
        (b'{"gamma": 0.3}', "no request is called"),
    ],
)
def test_a_malformed_line_gets_an_error_and_changes_nothing(speaker: Speaker, line: bytes, says: str) -> None:
    session = Session(here=np.zeros(6), greeted=True) if b"dt" in line else Session(greeted=True)
    before, here = say(speaker, "state"), session.here
    found = say(speaker, line, session)
    assert found["ok"] is False
    assert says in found["error"]
    assert "q_rad" not in json.dumps(found)
    after = say(speaker, "state")
    assert session.here is here
    assert {k: v for k, v in after.items() if k not in ("answered", "refused")} == {
        k: v for k, v in before.items() if k not in ("answered", "refused")
    }


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.one_of(
    st.binary(max_size=200),
    st.builds(lambda w, k, v: f"{w} {k}={v}".encode("latin1", "replace"), st.sampled_from(sorted(WORDS)),
              st.sampled_from(["gamma", "q", "near", "link", "dt", "id"]), st.text(max_size=30)),
))  # fmt: skip
def test_no_line_raises(speaker: Speaker, line: bytes) -> None:
    one = line.replace(b"\n", b" ")  # a newline ends a line: what comes after it would be another one
    assert isinstance(say(speaker, one)["ok"], bool)


def test_a_stream_follows_its_last_target_and_refuses_what_is_too_fast(speaker: Speaker) -> None:
    session = Session(greeted=True)
    none = say(speaker, "stream gamma=0.30 delta=0.2 r=0.8", session)
    assert "expected a posture to start from" in none["error"]
    assert say(speaker, f"start q={','.join(map(str, START))}", session)["ok"]
    first = say(speaker, "stream gamma=0.30 delta=0.2 r=0.8", session)
    assert first["number"] == 1
    assert first["path"]["safe"] is True
    second = say(speaker, "stream gamma=0.31 delta=0.2 r=0.8 dt=1", session)
    assert second["number"] == 2
    assert second["needs_s"] < 1
    assert np.abs(np.subtract(second["solutions"][0]["q_rad"], first["solutions"][0]["q_rad"])).max() < 0.1
    here = session.here
    fast = say(speaker, "stream gamma=0.9 delta=0.2 r=0.8 dt=0.01", session)
    assert fast["ok"] is False
    assert "the joints need" in fast["error"]
    assert session.here is here
    assert say(speaker, "stream gamma=0.31 delta=0.21 r=0.8 dt=1", session)["number"] == 3


def test_a_stream_begins_where_the_linked_robot_is_and_takes_sides(detector: Detector) -> None:
    speaker, session = Speaker(detector, Arm(np.array(START))), Session(greeted=True)
    q = np.array(say(speaker, "stream gamma=0.3 delta=0.2 r=0.8", session)["solutions"][0]["q_rad"])
    moved = np.sign(q - START)
    session = Session(greeted=True)
    told = say(speaker, f"stream gamma=0.3 delta=0.2 r=0.8 direction={','.join(f'{-s:.0f}' for s in moved)}", session)
    assert told["direction_from"] == "asked"
    assert told["solutions"][0]["approach_direction"] == (-moved).tolist()
    assert "comes from another side" in told["notes"][0]
    assert 1e-9 < np.abs(np.subtract(told["solutions"][0]["q_rad"], q)).max() < 0.01
    assert session.here is not None
    assert session.here.tolist() == told["solutions"][0]["q_rad"]


def test_a_stream_takes_no_other_posture_where_the_nearest_is_refused(speaker: Speaker) -> None:
    session = Session(here=np.array([float(x) for x in BESIDE_THE_STAGE.split(",")]), greeted=True)
    here = session.here
    assert "sample stage" in say(speaker, "stream gamma=0.3 delta=0.2 r=0.4", session)["error"]
    assert session.here is here


def test_a_path_is_checked_along_its_length(speaker: Speaker) -> None:
    session = Session(greeted=True)
    q = say(speaker, GOOD)["solutions"][0]["q_rad"]
    assert say(speaker, f"start q={','.join(map(str, q))}", session)["ok"]
    assert say(speaker, "path gamma=0.35 delta=0.2 r=0.8", session)["path"]["safe"] is True
    through = [*q[:4], q[4], q[5]]
    through[1] = np.deg2rad(60.0)  # down into the stage and the floor of the limits
    far = say(speaker, f"path to={','.join(map(str, through))}", session)
    assert far["path"]["safe"] is False


def test_a_path_with_an_approach_is_checked_on_both_legs(speaker: Speaker) -> None:
    near = "0.1,-1.2,1.2,0.1,0.4,0"
    found = say(speaker, f"path gamma=0.3 delta=0.2 r=0.8 approach=yes from={near}")
    assert found["path"]["safe"] is True
    through, end = np.array(found["approach"]["through_q_rad"]), np.array(found["solutions"][0]["q_rad"])
    assert 1e-3 < np.abs(end - through).max() < 0.1
    legs = [np.array([float(x) for x in near.split(",")]), through, end]
    whole = check_path(speaker.detector, legs)
    assert found["path"]["duration_s"] == pytest.approx(whole.duration, rel=1e-9)
    assert whole.duration > check_path(speaker.detector, legs[::2]).duration
    assert found["path"]["least_distance_m"] == pytest.approx(whole.clearance, rel=1e-9)


BESIDE_THE_STAGE = "0.5,-0.2,1.2,3,-1.4,0"  # from here the nearest posture lies behind the sample stage


def test_another_posture_is_taken_where_the_nearest_is_refused_and_that_is_said(speaker: Speaker) -> None:
    found = say(speaker, f"path gamma=0.3 delta=0.2 r=0.4 from={BESIDE_THE_STAGE}")
    assert found["path"]["safe"] is True
    assert "the nearest posture is refused (sample stage" in found["notes"][0]
    (refused,) = found["refused"]
    assert "sample stage" in refused["reasons"][0]
    start = np.array([float(x) for x in BESIDE_THE_STAGE.split(",")])
    taken, nearest = found["solutions"][0]["q_rad"], refused["q_rad"]
    assert np.abs(taken - start).max() > np.abs(nearest - start).max()
    straight = say(speaker, f"path to={','.join(map(str, taken))} from={BESIDE_THE_STAGE}")
    assert straight["path"]["safe"] is True


def test_where_all_postures_are_asked_for_each_way_is_checked(speaker: Speaker) -> None:
    found = say(speaker, f"path gamma=0.3 delta=0.2 r=0.4 branch=all from={BESIDE_THE_STAGE}")
    assert {s["path"]["safe"] for s in found["solutions"]} == {True, False}
    assert found["path"] == found["solutions"][0]["path"]
    for solution in found["solutions"]:
        alone = say(speaker, f"path to={','.join(map(str, solution['q_rad']))} from={BESIDE_THE_STAGE}")
        assert alone["path"]["safe"] is solution["path"]["safe"]


def test_a_branch_that_was_asked_for_is_kept_though_its_way_is_refused(speaker: Speaker) -> None:
    every = say(speaker, f"path gamma=0.3 delta=0.2 r=0.4 branch=all from={BESIDE_THE_STAGE}")["solutions"]
    bad = next(s for s in every if not s["path"]["safe"])
    alone = f"S{bad['status']}T{bad['turn']}"
    found = say(speaker, f"path gamma=0.3 delta=0.2 r=0.4 branch={alone} from={BESIDE_THE_STAGE}")
    assert found["path"]["safe"] is False
    assert np.allclose(found["solutions"][0]["q_rad"], bad["q_rad"], atol=1e-9)


def test_temperatures_change_answers_for_all(speaker: Speaker) -> None:
    before = say(speaker, GOOD)["solutions"][0]["q_rad"]
    told = say(speaker, "temperature link=45,45,45,45,45,45")
    assert told["link_C"] == pytest.approx([45.0] * 6)
    assert told["notes"] == []
    after = say(speaker, GOOD)["solutions"][0]["q_rad"]
    assert 1e-7 < np.abs(np.subtract(before, after)).max() < 1e-2


def test_a_temperature_unused_by_the_model_is_reported(speaker: Speaker, detector: Detector) -> None:
    told = say(speaker, "temperature motor=45,45,45,45,45,45")
    assert told["notes"] == ["the motor temperatures are not used: no effect of this model depends on them"]
    assert say(speaker, "state")["notes"] == told["notes"]
    assert say(Speaker(detector), "state")["notes"] == []
    cold = Speaker(Detector(drawn_arm(effects=("geometry",)), detector.cell))
    assert "link temperatures" in say(cold, "state")["notes"][0]
    q = say(cold, GOOD)["solutions"][0]["q_rad"]
    say(cold, "temperature link=45,45,45,45,45,45")
    assert say(cold, GOOD)["solutions"][0]["q_rad"] == q


def test_at_is_where_the_other_way_round(speaker: Speaker) -> None:
    near = "near=0.1,-1.2,1.2,0.1,0.4,0"
    for asked in ((0.3, 0.2, 0.8, 0.0), (-0.2, 0.5, 0.6, 0.4)):
        names = dict(zip(("gamma", "delta", "r", "roll"), asked, strict=True))
        there = say(speaker, f"where {' '.join(f'{k}={v}' for k, v in names.items())} {near}")["solutions"][0]
        q = ",".join(map(str, there["q_rad"]))
        back = say(speaker, f"at q={q} {near}")
        assert [back[k] for k in ("gamma_rad", "delta_rad", "r_m", "roll_rad")] == pytest.approx(asked, abs=1e-8)
        assert np.abs(back["tilt_rad"]).max() < 1e-8
        assert back["motor_rad"] == pytest.approx(there["motor_rad"], rel=1e-12)
        assert back["tangential_std_m"] == pytest.approx(there["tangential_std_m"], rel=1e-5)
        assert back["radial_std_m"] == pytest.approx(there["radial_std_m"], rel=1e-5)
        # From the other side the clearances lie on the other flanks.
        other = say(
            speaker, f"at q={q} near={','.join(str(2 * a - b) for a, b in zip(there['q_rad'], START, strict=True))}"
        )
        assert 1e-7 < abs(other["gamma_rad"] - back["gamma_rad"]) < 1e-2


def test_at_tells_a_normal_that_misses_the_sample_and_limits(speaker: Speaker) -> None:
    q = say(speaker, GOOD)["solutions"][0]["q_rad"]
    q[4] += 0.1
    assert np.linalg.norm(say(speaker, f"at q={','.join(map(str, q))}")["tilt_rad"]) > 0.05
    q[4] = 2.6
    assert say(speaker, f"at q={','.join(map(str, q))}")["beyond_limits"] == [speaker.detector.robot.joints[4].name]
    session = Session(greeted=True)
    say(speaker, f"start q={','.join(map(str, q))}", session)
    assert say(speaker, "at", session)["q_rad"] == q


def test_stop_stops_the_linked_robot(detector: Detector) -> None:
    arm = Arm(detector.locate(0.3, 0.2, 0.8).solutions[0].q)
    speaker = Speaker(detector, arm)
    assert say(speaker, "move gamma=0.35 delta=0.2 r=0.8")["moving"] is True
    assert say(speaker, "stop")["link"] == {"moving": False}
    assert arm.told == []


def test_help_lists_every_request_and_quit_ends(speaker: Speaker) -> None:
    assert set(say(speaker, "help")["requests"]) == set(WORDS)
    session = Session(greeted=True)
    say(speaker, "quit", session)
    assert session.done


def test_the_page_of_the_protocol_names_every_request_and_key() -> None:
    page = (Path(__file__).parents[2] / "docs" / "reference" / "server.md").read_text(encoding="utf-8")
    for word, keys in WORDS.items():
        assert f"`{word}`" in page
        assert all(f"`{key}" in page for key in keys), word


class Arm:
    """A link that remembers what it was told."""

    def __init__(self, q: np.ndarray) -> None:
        self.q, self.told = q, []

    def posture(self) -> np.ndarray:
        return self.q

    def move(self, postures: np.ndarray, speed: float) -> None:
        self.told.append((postures, speed))

    def state(self) -> Mapping[str, Any]:
        return {"moving": bool(self.told)}

    def stop(self) -> None:
        self.told.clear()


def test_the_seam_moves_a_robot_only_where_the_way_is_safe(detector: Detector) -> None:
    q = detector.locate(0.3, 0.2, 0.8).solutions[0].q
    arm = Arm(q)
    speaker = Speaker(detector, arm)
    assert say(speaker, "state")["link"] == {"moving": False}
    found = say(speaker, "move gamma=0.35 delta=0.2 r=0.8")
    assert found["moving"] is True
    assert np.allclose(arm.told[0][0][-1], found["solutions"][0]["q_rad"], atol=1e-9)
    arm.told.clear()
    away = q.copy()
    away[1] = np.deg2rad(60.0)
    arm.q = away
    assert say(speaker, "move gamma=0.35 delta=0.2 r=0.8")["moving"] is False
    assert not arm.told
    say(speaker, "move gamma=30 delta=0.2 r=0.8")
    assert not arm.told


def test_a_move_goes_to_the_posture_that_was_found_safe(detector: Detector) -> None:
    arm = Arm(np.array([float(x) for x in BESIDE_THE_STAGE.split(",")]))
    found = say(Speaker(detector, arm), "move gamma=0.3 delta=0.2 r=0.4")
    assert found["moving"] is True
    assert len(found["refused"]) == 1
    assert np.allclose(arm.told[0][0], [found["solutions"][0]["q_rad"]], atol=1e-9)


def test_a_move_with_an_approach_goes_through_its_point(detector: Detector) -> None:
    arm = Arm(np.array([0.1, -1.2, 1.2, 0.1, 0.4, 0.0]))
    found = say(Speaker(detector, arm), "move gamma=0.3 delta=0.2 r=0.8 approach=yes")
    assert found["moving"] is True
    through = [found["approach"]["through_q_rad"], found["solutions"][0]["q_rad"]]
    assert np.allclose(arm.told[0][0], through, atol=1e-9)


def test_frames_stand_beside_the_joints_in_state_and_start(speaker: Speaker) -> None:
    session, q = Session(greeted=True), ",".join(map(str, START))
    assert say(speaker, "state", session)["frames"] is None  # nobody has said where it is
    begun, shown = say(speaker, f"start q={q}", session), say(speaker, f"at q={q}", session)
    told = say(speaker, "state", session)["frames"]
    for name in ("detector", "flange", "controller_flange"):
        assert begun[name] == told[name] == shown[name]
