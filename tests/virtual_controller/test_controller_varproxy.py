"""KUKAVARPROXY, as the unmodified ``py-openshowvar`` in a process of its own speaks it."""

from __future__ import annotations

import json
import socket
import struct
import subprocess
import sys

import numpy as np
import pytest
from controller_client import HOME, STEP, inside, move, same_place

PEER = """
import json, sys
from py_openshowvar import openshowvar
client = openshowvar("127.0.0.1", int(sys.argv[1]))
assert client.can_connect
told = {}
for name in sys.argv[2:]:
    name, _, value = name.partition("=")
    answer = client.write(name, value, debug=False) if value else client.read(name, debug=False)
    told[name] = None if answer is None else answer.decode()
client.close()
print(json.dumps(told))
"""


def peer(port: int, *names: str) -> dict[str, str | None]:
    pytest.importorskip("py_openshowvar")
    done = subprocess.run(
        [sys.executable, "-c", PEER, str(port), *names], check=False, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    told: dict[str, str | None] = json.loads(done.stdout)
    return told


def test_unmodified_peer_reads_and_writes() -> None:
    with inside(speed=1000.0) as robot:
        assert robot.run(1, [HOME + STEP]) == [1, 2, 3]
        state = robot.ask()
        indexed = ("$TORQUE_AXIS_ACT[2]", "$CURR_ACT[3]", "$MOT_TEMP[1]")
        told = peer(
            robot.at["varproxy"][1], "$AXIS_ACT_MEAS", *indexed, "$OV_PRO=30", "$OV_PRO", "$MODE_OP", "$NO_SUCH",
            "$TORQUE_AXIS_ACT[7]", "$OV_PRO=101", "$MODE_OP=#T1", "$axis_act_meas",
        )  # fmt: skip
        axes = told["$AXIS_ACT_MEAS"] or ""
        assert axes.startswith("{E6AXIS: A1 ")
        assert axes.endswith("E6 0.0}")
        found = [float(part.split()[-1]) for part in axes.removeprefix("{E6AXIS: ").split(",")[:6]]
        assert same_place(found, HOME + STEP)
        assert float(told["$TORQUE_AXIS_ACT[2]"] or 0) == pytest.approx(state["Torque.A2"], abs=1.0)
        assert float(told["$MOT_TEMP[1]"] or 0) == pytest.approx(state["Temperature.A1"], abs=2)
        assert told["$MODE_OP"] is None  # the mode switch is turned by hand
        assert told["$OV_PRO"] is None  # 101 was refused
        assert (told["$NO_SUCH"], told["$TORQUE_AXIS_ACT[7]"]) == (None, None)
        assert peer(robot.at["varproxy"][1], "$OV_PRO", "$MODE_OP") == {"$OV_PRO": "30", "$MODE_OP": "#EX"}
        assert robot.robot.controller.override == 30.0


def test_override_slows_what_is_accepted_later() -> None:
    with inside(speed=1.0) as robot:
        robot.ask()
        lengths = []
        for number, override in enumerate((100, 50), 1):
            robot.robot.controller.override = float(override)
            with robot.motion() as link:
                link.send(b"".join(move(1, number, [HOME + 20 * number, HOME], 20.0)))
                link.receive()
                lengths.append(np.diff(robot.robot.controller.span(2))[0])
                robot.ask(1)
                robot.ask(2)
            while robot.ask(2)["State.Stopped"]:
                pass
        assert lengths[1] > 1.5 * lengths[0]


@pytest.mark.parametrize(
    "request_",
    [
        b"\0\1\0\0", b"\0\1\xff\xff", b"\0\1\0\4\0\0\x09$", b"\0\1\0\5\7\0\2$A", b"\0\1\0\4\1\0\1$",
        struct.pack(">HHBH", 1, 12, 1, 7) + b"$OV_PRO" + b"\0\1"[:2],
    ],
)  # fmt: skip
def test_bad_requests_are_refused(request_: bytes) -> None:
    with inside() as robot, socket.create_connection(robot.at["varproxy"], 5) as sock:
        sock.sendall(request_)
        sock.settimeout(0.5)
        try:
            answer = sock.recv(100)
        except TimeoutError:
            answer = b""
        assert answer == b"" or answer.endswith(b"\0\0\0")
        assert robot.ask()["State.Accepted"] == 0
