"""EPICS motor records, driven by an unmodified caproto client in a process of its own."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from memory_link import MemoryLink
from peers import Peer, free_udp_and_tcp, peer, side
from serving_thread import Serving

from clampid.verbs.errors import CallError
from offline_ik.inverse.detector import Detector

pytest.importorskip("caproto")
DONE = "gamma.DMOV"


@pytest.fixture(scope="module")
def link() -> MemoryLink:
    return MemoryLink(seconds=0.3)


@pytest.fixture(scope="module")
def serving(detector: Detector, link: MemoryLink) -> Iterator[Serving]:
    with Serving(detector, link) as found:
        yield found


def searching(port: int) -> dict[str, str]:
    return {"EPICS_CA_ADDR_LIST": f"127.0.0.1:{port}", "EPICS_CA_AUTO_ADDR_LIST": "NO"}


@pytest.fixture(scope="module")
def epics(serving: Serving) -> Iterator[Peer]:
    port = free_udp_and_tcp()
    with (
        side("epics_records", "BL:DET:", "--server", serving.address, "--listen", f"127.0.0.1:{port}") as at,
        peer("epics_client.py", "BL:DET:", **searching(port)) as client,
    ):
        assert at == f"127.0.0.1:{port} BL:DET:gamma BL:DET:delta BL:DET:radius"
        yield client


@pytest.fixture(autouse=True)
def at_the_start(epics: Peer, link: MemoryLink) -> None:
    link.seconds = 0.3
    assert epics.ask("put gamma 20 delta 11 radius 800") == {"ok": [True, True, True]}


def soon(holds: Callable[[], Any]) -> None:
    limit = time.monotonic() + 10
    while not holds():
        assert time.monotonic() < limit
        time.sleep(0.02)


def test_put_completion_comes_when_the_motion_has_ended(epics: Peer, link: MemoryLink) -> None:
    sent, begun = len(link.sent), time.monotonic()
    assert epics.ask("put gamma 22") == {"ok": [True]}
    assert time.monotonic() - begun >= link.seconds
    assert not link.state()["moving"]
    assert len(link.sent) == sent + 1
    assert epics.ask("read gamma.RBV")["ok"] == pytest.approx([22.0], abs=1e-3)
    assert epics.ask("read gamma")["ok"] == pytest.approx([22.0], abs=1e-12)
    assert epics.ask("read delta")["ok"] == pytest.approx([11.0], abs=1e-12)
    assert epics.ask(f"read {DONE}")["ok"] == [1]


def test_what_is_put_within_a_moment_is_one_motion(epics: Peer, link: MemoryLink) -> None:
    sent = len(link.sent)
    assert epics.ask("put gamma 21 delta 12 radius 810") == {"ok": [True, True, True]}
    assert len(link.sent) == sent + 1
    assert epics.ask("read measured")["ok"] == pytest.approx([21, 12, 810], abs=0.01)


def test_one_lock_spans_the_axes(epics: Peer, link: MemoryLink) -> None:
    """A put that comes while another axis moves waits, and is neither lost nor refused."""
    sent = len(link.sent)
    epics.ask("send gamma 23")
    soon(lambda: link.state()["moving"])
    assert epics.ask("put delta 12") == {"ok": [True]}
    assert len(link.sent) == sent + 2
    assert epics.ask("read measured")["ok"] == pytest.approx([23, 12, 800], abs=0.01)


@pytest.mark.parametrize(
    ("put", "says"), [("radius 2500", "within"), ("delta -75", ""), ("gamma 200", "-180 to 180"), ("radius nan", "")]
)
def test_a_refusal_toggles_dmov_and_fails_the_put(epics: Peer, link: MemoryLink, put: str, says: str) -> None:
    sent, axis = len(link.sent), put.split(maxsplit=1)[0]
    before = epics.ask(f"read {axis}")["ok"]
    epics.ask(f"watch {axis}.DMOV")
    soon(lambda: epics.ask(f"seen {axis}.DMOV")["ok"])
    assert epics.ask(f"put {put}") == {"ok": [False]}
    soon(lambda: epics.ask(f"seen {axis}.DMOV")["ok"][-3:] == [1, 0, 1])
    assert says in epics.ask("read refusal")["ok"] != ""
    assert epics.ask(f"read {axis}")["ok"] == before
    assert epics.ask(f"read {axis}.LVIO")["ok"] == [int("-180" in says or "nan" in put)]
    assert len(link.sent) == sent
    assert epics.ask("put gamma 20.5") == {"ok": [True]}
    assert epics.ask("read refusal")["ok"] == ""


def test_control_limits_and_units_are_published(epics: Peer) -> None:
    for axis, low, high in (("gamma", -180, 180), ("delta", -90, 90), ("radius", 0, 10_000)):
        assert epics.ask(f"limits {axis}")["ok"] == [low, high]
        assert epics.ask(f"limits {axis}.RBV")["ok"] == [low, high]
        assert epics.ask(f"read {axis}.LLM")["ok"] + epics.ask(f"read {axis}.HLM")["ok"] == [low, high]
        assert epics.ask(f"read {axis}.DLLM")["ok"] + epics.ask(f"read {axis}.DHLM")["ok"] == [low, high]


@pytest.mark.parametrize("how", ["gamma.STOP", "stop"])
def test_stop_ends_the_motion_and_fails_its_put(epics: Peer, link: MemoryLink, how: str) -> None:
    link.seconds = 30.0
    epics.ask("send gamma 40")
    soon(lambda: link.state()["moving"])
    soon(lambda: epics.ask("read gamma.MOVN")["ok"] == [1])
    assert epics.ask(f"read {DONE}")["ok"] == [0]
    epics.ask(f"send {how} 1")
    soon(lambda: not link.state()["moving"])
    soon(lambda: epics.ask(f"read {DONE}")["ok"] == [1])
    assert "stopped" in epics.ask("read refusal")["ok"]
    assert abs(epics.ask("read gamma")["ok"][0] - 40) > 5


def test_who_holds_it_and_what_others_do_is_shown(epics: Peer, serving: Serving, link: MemoryLink) -> None:
    link.seconds = 1.5
    with serving.client("alignment") as other:
        assert other.ask(f"move gamma={math.radians(25)!r} delta=0.2 r=0.8")["moving"]
        soon(lambda: epics.ask("read holder")["ok"].startswith("alignment (127.0.0.1:"))
        assert epics.ask("put gamma 20") == {"ok": [False]}
        assert "moves for alignment" in epics.ask("read refusal")["ok"]
        other.ask("moved")
    soon(lambda: epics.ask("read gamma")["ok"] == pytest.approx([25.0], abs=1e-9))
    stds = epics.ask("read uncertainty")["ok"]
    assert all(0 < std < 5 for std in stds)


def test_what_cannot_be_read_is_trouble_and_no_refusal(
    epics: Peer, link: MemoryLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unknown() -> None:
        raise CallError("the robot's posture is not known")

    assert epics.ask("put radius 2500") == {"ok": [False]}
    refusal = epics.ask("read refusal")["ok"]
    with monkeypatch.context() as patched:
        patched.setattr(link, "posture", unknown)
        soon(lambda: "not known" in epics.ask("read trouble")["ok"])
        assert epics.ask("alarm gamma.RBV")["ok"] == 3  # INVALID
        assert epics.ask("read refusal")["ok"] == refusal
    soon(lambda: epics.ask("read trouble")["ok"] == "")
    assert epics.ask("alarm gamma.RBV")["ok"] == 0
    assert epics.ask("read refusal")["ok"] == refusal


def test_records_that_a_network_reaches_move_only_with_the_token(detector: Detector) -> None:
    link, port = MemoryLink(), free_udp_and_tcp()
    listen = f"127.0.0.1:{port}"
    with (
        Serving(detector, link, token="secret-7") as serving,
        side("epics_records", "X:", "--server", serving.address, "--listen", listen, "--lock", "token"),
        peer("epics_client.py", "X:", **searching(port)) as client,
    ):
        assert client.ask("put gamma 20") == {"ok": [False]}
        assert "locked" in client.ask("read refusal")["ok"]
        assert client.ask("text unlock other") == {"ok": False}
        assert client.ask("text unlock secret-7") == {"ok": True}
        assert client.ask("put gamma 20 delta 11 radius 800") == {"ok": [True] * 3}
        assert len(link.sent) == 1
        assert "secret" not in client.ask("read unlock")["ok"]
