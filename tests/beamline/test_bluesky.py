"""The ophyd-async device, driven by a bluesky RunEngine in a process of its own."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
from memory_link import MemoryLink
from peers import Peer, peer
from serving_thread import Serving

from offline_ik.inverse.detector import Detector

pytest.importorskip("bluesky")
pytest.importorskip("ophyd_async")
START = {"gamma": 20.0, "delta": 11.0, "radius": 800.0}


@pytest.fixture(scope="module")
def link() -> MemoryLink:
    return MemoryLink(seconds=0.1, residual=1e-5)


@pytest.fixture(scope="module")
def serving(detector: Detector, link: MemoryLink) -> Iterator[Serving]:
    with Serving(detector, link) as found:
        yield found


@pytest.fixture(scope="module")
def engine(serving: Serving) -> Iterator[Peer]:
    with peer("bluesky_client.py", serving.address) as client:
        yield client


def ask(engine: Peer, do: str, **given: Any) -> Any:
    return engine.ask(json.dumps({"do": do, **given}))


@pytest.fixture(autouse=True)
def at_the_start(engine: Peer, link: MemoryLink) -> None:
    link.seconds = 0.1
    assert ask(engine, "set", value=START) == []


def test_three_coordinates_are_one_motion(engine: Peer, link: MemoryLink) -> None:
    sent = len(link.sent)
    assert ask(engine, "set", value={"gamma": 21.0, "delta": 12.0, "radius": 810.0}) == []
    assert len(link.sent) == sent + 1
    found = ask(engine, "locate")
    assert found["setpoint"] == pytest.approx({"gamma": 21.0, "delta": 12.0, "radius": 810.0}, abs=1e-12)
    assert found["readback"] == pytest.approx(found["setpoint"], abs=0.05)
    assert found["readback"] != found["setpoint"]
    assert ask(engine, "set", value={"delta": 11.5}) == []  # the others stay where they were asked to be
    assert ask(engine, "locate")["setpoint"] == pytest.approx(
        {"gamma": 21.0, "delta": 11.5, "radius": 810.0}, abs=1e-12
    )


def test_axes_that_are_set_together_are_one_motion(engine: Peer, link: MemoryLink) -> None:
    sent = len(link.sent)
    assert ask(engine, "axes", value={"gamma": 21.0, "delta": 12.0, "radius": 810.0}) == []
    assert len(link.sent) == sent + 1
    assert ask(engine, "axes", value={"radius": 800.0}) == []
    assert len(link.sent) == sent + 2


def test_a_grid_makes_as_many_motions_as_it_has_points(engine: Peer, link: MemoryLink) -> None:
    sent = len(link.sent)
    events = ask(engine, "grid", gamma=[19.0, 21.0, 3], delta=[10.0, 12.0, 3])
    assert len(link.sent) == sent + 9
    at = [(event["detector-gamma"], event["detector-delta"]) for event in events]
    asked = [(g, d) for g in (19.0, 20.0, 21.0) for d in (10.0, 11.0, 12.0)]
    assert [g for g, _ in at] == pytest.approx([g for g, _ in asked], abs=0.01)
    assert [d for _, d in at] == pytest.approx([d for _, d in asked], abs=0.01)


@pytest.mark.parametrize("do", ["set", "axes"])
def test_a_refusal_fails_before_anything_moves(engine: Peer, link: MemoryLink, do: str) -> None:
    sent = len(link.sent)
    assert "within" in ask(engine, do, value={"radius": 2500.0})["failed"]
    assert "RefusedError" in ask(engine, "check", value={"radius": 2500.0})
    assert ask(engine, "check", value={"radius": 810.0}) == ""
    assert len(link.sent) == sent
    assert ask(engine, "locate")["setpoint"] == pytest.approx(START, abs=1e-12)
    assert ask(engine, do, value={"radius": 801.0}) == []


def test_stop_fails_the_motion(engine: Peer, link: MemoryLink) -> None:
    link.seconds = 30.0
    assert "stopped" in ask(engine, "stopped", value={"gamma": 40.0})["failed"]
    assert not link.state()["moving"]


def test_what_is_read(engine: Peer) -> None:
    (event,) = ask(engine, "read")
    assert event["detector-gamma"] == pytest.approx(20.0, abs=0.01)
    assert event["detector-radius"] == pytest.approx(800.0, abs=0.1)
    assert 0 < event["detector-gamma_std"] < 0.1
    assert 0 < event["detector-radius_std"] < 5


def test_who_else_moves_it_is_reported(engine: Peer, serving: Serving, link: MemoryLink) -> None:
    link.seconds = 1.0
    with serving.client("alignment") as other:
        assert other.ask("move gamma=0.36 delta=0.2 r=0.8")["moving"]
        assert "moves for alignment" in ask(engine, "set", value={"gamma": 21.0})["failed"]
        assert other.ask("moved")["ended"]["outcome"] == "arrived"
