"""Names and addresses of the sides of the beamline: what can be none is refused in a line, before anything listens."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest
from free_ports import free_port
from peers import free_udp_and_tcp, peer, side
from serving_thread import Serving

from clampid.cli import run
from kinematics.host_port import host_and_port

LONG = "a" * 10_000
NAMES = [
    "", "a", "a/b/c", "a/b\n", "\na/b", "a/b\r", "a\0/b", "*/b", "a/?", "a/[b]", "-x/y", "a/-v4", "--/--", "../..",
    "./b", "a/b ", "ä/b", "\x1b[2J/b", "\u202ea/b", "\udc80/b", f"a/{LONG}", f"{LONG}/b", "dserver/x", "SYS/b",
    "$(id)/b", "a\\b/c",
]  # fmt: skip
PREFIXES = [
    "", "-X:", "--help", "X:\n", "X*", "X?", "X.Y:", "...", "X/", "X\0", "ä:", "\x1b[2J", "\u202eX:", "\udc80", "X Y",
    "{}", "$(id)", "X" * 41, LONG,
]  # fmt: skip
ADDRESSES = [
    "", ":1", "1", "127.0.0.1", "127.0.0.1\n:7311", "127.0.0.1:7311\n", "-x:1", "*:1", "a b:1", "ä:1", "\x1b[2J:5",
    "127.0.0.1\0:1", "127.0.0.1:²", "127.0.0.1:٧", "127.0.0.1:99999", "127.0.0.1:-1", f"127.0.0.1:{'9' * 5000}",
    f"{LONG}:1", f"{'a' * 64}.b:1", "a..b:1", "[::1:1", "/:1", "a/b:1",
]  # fmt: skip


RUN = ["run", "still.toml", "-o", "out"]
HOSTS = [
    ("[::1]:5", ("::1", 5)), ("::1:5", ("::1", 5)), ("fe80::1%eth0:5", ("fe80::1%eth0", 5)),
    ("a-b.c_d:65535", ("a-b.c_d", 65535)),
]  # fmt: skip


def said_of(capsys: pytest.CaptureFixture[str], *call: str) -> str:
    """The only line that a refused call says."""
    assert run(["serve", *call]) == 2
    done = capsys.readouterr()
    assert not done.out
    assert len(done.err.splitlines()) == 1
    assert len(done.err) < 400
    assert done.err.isprintable() or done.err[:-1].isprintable()
    return done.err


@pytest.fixture
def nothing_listens(monkeypatch: pytest.MonkeyPatch) -> None:
    def listen(*_: object) -> None:
        raise AssertionError("something listens")

    monkeypatch.setattr(socket.socket, "listen", listen)


@pytest.mark.usefixtures("nothing_listens")
@pytest.mark.parametrize("name", NAMES, ids=lambda name: ascii(name)[:20])
def test_a_name_that_no_device_can_have_is_refused(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    said = said_of(capsys, "no-model.json", f"--tango={name}", "--link", "eki://127.0.0.1:9")
    assert said.startswith("clampid: --tango: expected ")


@pytest.mark.usefixtures("nothing_listens")
@pytest.mark.parametrize("prefix", PREFIXES, ids=lambda name: ascii(name)[:20])
def test_a_prefix_that_no_record_can_have_is_refused(prefix: str, capsys: pytest.CaptureFixture[str]) -> None:
    said = said_of(capsys, "no-model.json", f"--epics={prefix}", "--link", "eki://127.0.0.1:9")
    assert said.startswith("clampid: --epics: expected a prefix")


@pytest.mark.usefixtures("nothing_listens")
@pytest.mark.parametrize("text", ADDRESSES, ids=lambda text: ascii(text)[:20])
@pytest.mark.parametrize("option", ["--listen", "--tango-listen", "--epics-listen"])
def test_an_address_that_is_none_is_refused(option: str, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    sides = ["--tango", "a/b", "--epics", "X:", "--link", "eki://127.0.0.1:9"]
    assert said_of(capsys, "no-model.json", f"{option}={text}", *sides).startswith(f"clampid: {option}: expected HOST")


@pytest.mark.parametrize("text", ADDRESSES, ids=lambda text: ascii(text)[:20])
@pytest.mark.parametrize("call", [
    [*RUN, "--yes", "--instrument", "tcp://127.0.0.1:9", "--link"],
    [*RUN, "--yes", "--link", "eki://127.0.0.1:9", "--instrument=tcp"],
    [*RUN, "--link", "eki://127.0.0.1:9", "--instrument", "tcp://127.0.0.1:9", "--operator"],
    ["virtual-robot", "--listen"],
], ids=["link", "instrument", "operator", "virtual-robot"])  # fmt: skip
def test_other_verbs_refuse_it_too(
    call: list[str], text: str, still: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(still)
    *call, option = call
    separator = "://" if option == "--instrument=tcp" else "="
    assert run([*call, f"{option}{separator}{text}"]) == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert "expected" in said
    assert len(said) < 400


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("still")
    assert run(["plan", "fixed-point", "-o", str(folder / "still.toml"), "-q"]) == 0
    return folder


@pytest.mark.parametrize(("text", "at"), HOSTS)
def test_hosts_that_there_are_are_taken(text: str, at: tuple[str, int]) -> None:
    assert host_and_port(text) == at


def test_a_port_in_use_is_said_before_the_compiling(model_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        for option, name in (("--tango", "a/b"), ("--epics", "X:")):
            call = [option, name, f"{option}-listen", f"127.0.0.1:{port}", "--link", "eki://127.0.0.1:9"]
            said = said_of(capsys, str(model_file), "--listen", "127.0.0.1:0", *call)
            assert said.startswith(f"clampid: {option}-listen: cannot listen on 127.0.0.1:{port}")


@pytest.mark.parametrize("holder", ["a\\nb", "ä世", "x" * 64, "%s%n", "'; DROP", "\u202eabc"])
def test_a_holder_with_any_name_is_shown(holder: str, serving: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who holds the robot is told to Tango and EPICS clients, whose texts are Latin letters of bounded length."""
    pytest.importorskip("tango")
    with serving.client(hello=False) as client:
        if not client.ask(f"hello name={holder}")["ok"]:
            return
        assert client.ask("hold")["ok"]
        listen = ("--server", serving.address, "--listen", f"127.0.0.1:{free_port()}")
        with side("tango_device", "a/b", *listen) as at, peer("contrast_client.py", at.split()[-1]) as tango:
            assert "It is held by" in tango.ask("Status")["ok"]
        port = free_udp_and_tcp()
        searching = {"EPICS_CA_ADDR_LIST": f"127.0.0.1:{port}", "EPICS_CA_AUTO_ADDR_LIST": "NO"}
        arguments = ("X:", "--server", serving.address, "--listen", f"127.0.0.1:{port}")
        with side("epics_records", *arguments), peer("epics_client.py", "X:", **searching) as epics:
            assert epics.ask("read gamma.DMOV")["ok"] == [1]
            assert epics.ask("read holder")["ok"]
