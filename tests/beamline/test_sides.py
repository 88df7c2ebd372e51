"""The sides run for as long as the server does: started again when they end, ended with it whatever ends it."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest
from free_ports import free_port
from peers import HERE, free_udp_and_tcp, peer
from serving_thread import Serving
from typer.testing import CliRunner

from clampid.cli import app

pytest.importorskip("tango")
pytest.importorskip("caproto")


@contextmanager
def running(script: str, *arguments: str) -> Iterator[tuple[subprocess.Popen[str], Callable[[], str]]]:
    command = [sys.executable, str(HERE / script), *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process, process.stdout.readline
        finally:
            process.kill()


def gone(children: list[psutil.Process]) -> bool:
    return not any(child.is_running() and child.status() != psutil.STATUS_ZOMBIE for child in children)


def ended(process: subprocess.Popen[str], children: list[psutil.Process], how: signal.Signals) -> float:
    """How long process and children took to end, s."""
    begun = time.monotonic()
    process.send_signal(how)
    assert process.wait(20) == (0 if how == signal.SIGTERM else -signal.SIGKILL)
    while not gone(children):
        assert time.monotonic() - begun < 20
        time.sleep(0.02)
    return time.monotonic() - begun


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_sides_end_with_the_server_and_are_started_again_when_they_end(how: signal.Signals, serving: Serving) -> None:
    tango, epics = f"127.0.0.1:{free_port()}", f"127.0.0.1:{free_udp_and_tcp()}"
    sides = (f"tango tango_device a/b --listen {tango}", f"epics epics_records X: --listen {epics}")
    with running("run_sides.py", serving.address, *sides) as (process, line):
        at = line().split()[-1]
        assert at == f"tango://{tango}/a/b/detector#dbase=no"
        assert line().startswith(f"epics on {epics} X:gamma")
        children = psutil.Process(process.pid).children()
        assert len(children) == 2
        if how == signal.SIGTERM:
            next(c for c in children if "tango_device" in " ".join(c.cmdline())).kill()
            assert "tango: it ended by itself (exit code -9) and is started again" in line()
            assert line().split()[-1] == at
            children = psutil.Process(process.pid).children()
            with peer("contrast_client.py", at) as client:
                assert client.ask("wait")["ok"] == "ON"
        ended(process, children, how)


def test_a_side_that_does_not_start_is_said(serving: Serving) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        listen = f"127.0.0.1:{taken.getsockname()[1]}"
        with running("run_sides.py", serving.address, f"tango tango_device a/b --listen {listen}") as (process, line):
            assert line() == "--tango: it did not start; what it says is above\n"
            assert process.wait(20) == 2


@pytest.mark.slow
def test_the_whole_server_with_its_sides(model_file: Path, cell_file: Path) -> None:
    listen = f"127.0.0.1:{free_port()}"
    side = f"tango tango_device a/b --listen {listen}"
    with running("serve_memory.py", str(model_file), str(cell_file), side) as (process, line):
        assert line().startswith("listening on 127.0.0.1:")
        at = line().split()[-1]
        children = psutil.Process(process.pid).children()
        with peer("contrast_client.py", at) as client:
            assert client.ask("move 0 20")["ok"]["again"] == 0
        assert ended(process, children, signal.SIGTERM) < 5


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--tango", "a/b"], "--tango: expected a robot to move, found no --link"),
        (["--epics", "X:"], "--epics: expected a robot to move, found no --link"),
        (["--tango", "a"], "--tango: expected SERVER/INSTANCE, each"),
        (["--tango", "a/b --x"], "--tango: expected SERVER/INSTANCE"),
        (["--epics", "a b"], "--epics: expected a prefix"),
        (["--radius-unit", "inch"], "--radius-unit: expected mm, m, um, found 'inch'"),
    ],
)
def test_options_that_cannot_be_meant(options: list[str], says: str, model_file: Path) -> None:
    done = CliRunner().invoke(app(), ["serve", str(model_file), *options])
    assert done.exit_code != 0
    assert says in f"{done.output}{done.exception}"


@pytest.mark.parametrize(("option", "package"), [("--tango", "tango"), ("--epics", "caproto")])
def test_a_package_that_is_missing_is_said_in_a_line(
    option: str, package: str, model_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("offline_ik.beamline.processes.find_spec", lambda name: None)
    done = CliRunner().invoke(app(), ["serve", str(model_file), option, "a/b" if package == "tango" else "X:"])
    assert f"{option} needs {package}, which is not installed: python -m pip install 'clampid[" in str(done.exception)


def test_sides_that_a_network_reaches_are_locked() -> None:
    from offline_ik.beamline.options import Given, sides_of

    class Out:
        said: list[str] = []  # noqa: RUF012 - of one test

        def warn(self, text: str) -> None:
            self.said.append(text)

    token, out = Path("token"), Out()
    for listen, file, lock in (
        ("127.0.0.1:1", None, "no"), ("127.0.0.1:1", token, "no"), ("0.0.0.0:1", token, "token"),
        ("0.0.0.0:1", None, "closed"),
    ):  # fmt: skip
        (side,) = sides_of(Given("a/b", listen, None, "127.0.0.1:5064", "mm", file), True, out)  # type: ignore[arg-type]
        assert side.arguments[-2:] == ("--lock", lock)
        assert ("--token-file" in side.arguments) is (file is not None and lock == "no")
    assert len(out.said) == 2
