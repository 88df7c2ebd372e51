"""KUKAVARPROXY in both directions: the unmodified py-openshowvar asks our server; our client asks a proxy."""

from __future__ import annotations

import contextlib
import json
import random
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest
from variable_server import Questions, VariableServer, answer_bytes

from experiments.links.address import LinkAddress
from experiments.links.protocol import CannotError, Link, LinkLostError, Program
from experiments.links.varproxy import axes_of, connect
from experiments.links.varproxy_wire import Answers, Question, question_bytes

VARIABLES = {
    "$AXIS_ACT_MEAS": "{E6AXIS: A1 10.5, A2 -90.0, A3 9.0e1, A4 0.0, A5 -0.25, A6 350.0, E1 0.0, E2 0.0}",
    "$MODE_OP": "#EX",
    "$PERI_RDY": "TRUE",
    "$ALARM_STOP": "TRUE",
    "$BRAKE_SIG": "63",
    **{f"$TORQUE_AXIS_ACT[{k}]": f"{k}.5" for k in range(1, 7)},
    **{f"$CURR_ACT[{k}]": f"0.{k}" for k in range(1, 7)},
    **{f"$MOT_TEMP[{k}]": f"{300 + k}" for k in range(1, 7)},
}


@pytest.fixture
def variables() -> dict[str, str]:
    return dict(VARIABLES)


@pytest.fixture
def server(variables: dict[str, str]) -> Iterator[VariableServer]:
    def write(name: str, value: str) -> bool:
        if name != "$OV_PRO":
            return False
        variables[name] = value
        return True

    found = VariableServer("127.0.0.1", 0, variables.get, write)
    yield found
    found.close()


PEER = """
import json, sys
from py_openshowvar import openshowvar
client = openshowvar("127.0.0.1", int(sys.argv[1]))
found = [client.read(name, debug=False) for name in ("$AXIS_ACT_MEAS", "$NO_SUCH", "$MODE_OP")]
found.append(client.write("$OV_PRO", "25", debug=False))
found.append(client.write("$MODE_OP", "#T1", debug=False))
found.append(client.read("$OV_PRO", debug=False))
found += [client.read("$MOT_TEMP[3]", debug=False) for _ in range(500)]
client.close()
print(json.dumps([None if one is None else one.decode() for one in found]))
"""


def test_the_unmodified_py_openshowvar_reads_and_writes_over_our_server(
    server: VariableServer, variables: dict[str, str]
) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PEER, str(server.port)], capture_output=True, text=True, timeout=60, check=True
    )
    axis, missing, mode, written, refused, override, *temperatures = json.loads(done.stdout)
    assert (axis, missing, mode) == (VARIABLES["$AXIS_ACT_MEAS"], None, "#EX")
    assert (written, refused, override) == ("25", None, "25")
    assert temperatures == ["303"] * 500
    assert variables["$OV_PRO"] == "25"


def test_our_client_writes_what_py_openshowvar_writes() -> None:
    from py_openshowvar import openshowvar

    with socket.create_server(("127.0.0.1", 0)) as listening:
        theirs = openshowvar("127.0.0.1", listening.getsockname()[1])
        theirs.msg_id, theirs.varname, theirs.value = 513, b"$OV_PRO", b"50"
        assert question_bytes(Question(513, "$OV_PRO")) == theirs._pack_read_req()
        assert question_bytes(Question(513, "$OV_PRO", "50")) == theirs._pack_write_req()
        theirs.rsp = answer_bytes(513, False, "50")
        assert theirs._read_rsp() == b"50"
        theirs.close()


def test_the_link_reads_what_the_proxy_has(server: VariableServer) -> None:
    link = connect(LinkAddress("varproxy", "127.0.0.1", server.port, {"torque": "%"}))
    try:
        assert isinstance(link, Link)
        status = link.status()
        np.testing.assert_allclose(np.degrees(status.joints), [10.5, -90.0, 90.0, 0.0, -0.25, 350.0])
        assert (status.mode, status.drives, status.estop, status.brakes_open) == ("EXT", True, False, True)
        np.testing.assert_allclose(status.torque, np.arange(1, 7) + 0.5)
        np.testing.assert_allclose(status.temperature, np.arange(301, 307) - 273.15)
        assert status.accepted is None
        units = {s.name: s.unit for s in link.capabilities.signals}
        assert (units["torque"], units["current"]) == ("%", "unit unknown")
    finally:
        link.close()


def test_the_link_says_that_it_moves_nothing(server: VariableServer) -> None:
    link = connect(LinkAddress("varproxy", "127.0.0.1", server.port))
    try:
        able = link.capabilities
        assert (able.executes, able.stops, able.records) == (False, False, False)
        assert "reads only" in link.capabilities.cannot[0]
        for call in (lambda: link.execute(Program(np.zeros((1, 6)), 0.1)), link.stop, link.release):
            with pytest.raises(CannotError, match="reads only"):
                call()
    finally:
        link.close()


def test_a_proxy_that_goes_and_comes_back(server: VariableServer, variables: dict[str, str]) -> None:
    link = connect(LinkAddress("varproxy", "127.0.0.1", server.port))
    try:
        del variables["$AXIS_ACT_MEAS"]
        time.sleep(0.5)
        assert link.status().age > 0.3
        assert "$AXIS_ACT_MEAS" in link.trouble
        variables["$AXIS_ACT_MEAS"] = VARIABLES["$AXIS_ACT_MEAS"]
        end = time.monotonic() + 5.0
        while link.status().age > 0.3:
            assert time.monotonic() < end
            time.sleep(0.01)
    finally:
        link.close()


def test_nobody_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("experiments.links.varproxy.FIRST_STATUS_TIMEOUT", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with pytest.raises(LinkLostError):
        connect(LinkAddress("varproxy", "127.0.0.1", port))


@pytest.mark.parametrize("text", ["", "{A1 1}", "{E6AXIS: A1 x, A2 1, A3 1, A4 1, A5 1, A6 1}", "A1 1e99, " * 9])
def test_axes_that_are_none(text: str) -> None:
    with pytest.raises(ValueError, match="expected"):
        axes_of(text)


def test_messages_in_any_pieces() -> None:
    asked = [Question(1, "$A"), Question(2, "$B", "3"), Question(3, "$C[1]")]
    stream = b"".join(map(question_bytes, asked))
    for cut in range(len(stream)):
        questions = Questions()
        assert questions.feed(stream[:cut]) + questions.feed(stream[cut:]) == asked
    stream = answer_bytes(7, False, "1.5") + answer_bytes(8, True, None)
    for cut in range(len(stream)):
        answers = Answers()
        found = answers.feed(stream[:cut]) + answers.feed(stream[cut:])
        assert [(a.number, a.value) for a in found] == [(7, "1.5"), (8, None)]


@pytest.mark.parametrize("count", [5000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_spoilt_answers_are_errors_and_nothing_else(count: int) -> None:
    rng, errors = random.Random(1), 0
    good = answer_bytes(7, False, "1.5") + answer_bytes(8, True, "x")
    for _ in range(count):
        data = bytearray(good)
        for _ in range(rng.randrange(1, 6)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        try:
            Answers().feed(bytes(data))
        except ValueError:
            errors += 1
    assert errors > count / 10


def test_the_server_outlives_rubbish_and_silent_clients(server: VariableServer) -> None:
    silent = [socket.create_connection(("127.0.0.1", server.port)) for _ in range(5)]
    for data in (b"\xff" * 100, b"\0\1\0\0", b"\0\1\xff\xff", b"GET / HTTP/1.1\r\n\r\n"):
        with socket.create_connection(("127.0.0.1", server.port)) as rude:
            rude.sendall(data)
            rude.settimeout(5)
            with contextlib.suppress(ConnectionResetError):
                assert rude.recv(10) == b""
    link = connect(LinkAddress("varproxy", "127.0.0.1", server.port))
    link.close()
    for one in silent:
        one.close()
    assert threading.active_count() < 50
