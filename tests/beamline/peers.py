"""Peers in processes of their own: the sides of the beamline, and clients of them."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from free_ports import free_port

HERE = Path(__file__).parent


def free_udp_and_tcp() -> int:
    """A port that is free for both."""
    while True:
        port = free_port()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            try:
                udp.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port


@contextmanager
def side(module: str, *arguments: str) -> Iterator[str]:
    """A side of the beamline; where it says that it answers."""
    command = [sys.executable, "-m", f"offline_ik.beamline.{module}", *arguments]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            found = re.match(r"\w+ on (.*)", process.stdout.readline())
            assert found, "it did not start"
            yield found[1]
        finally:
            assert process.stdin is not None
            process.stdin.close()  # as when the server ends that started it
            try:
                assert process.wait(10) == 0
            finally:
                process.kill()


class Peer:
    """A client that answers lines of stdin with JSON on stdout."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process

    def send(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def hear(self) -> Any:
        assert self.process.stdout is not None
        return json.loads(self.process.stdout.readline())

    def ask(self, line: str) -> Any:
        self.send(line)
        return self.hear()


@contextmanager
def peer(script: str, *arguments: str, **environment: str) -> Iterator[Peer]:
    """A client of tests/beamline in a process of its own."""
    command = [sys.executable, str(HERE / script), *arguments]
    env = {**os.environ, **environment}
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=env) as process:
        try:
            yield Peer(process)
        finally:
            assert process.stdin is not None
            process.stdin.close()
            try:
                process.wait(10)
            finally:
                process.kill()
