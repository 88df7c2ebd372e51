"""The person at the robot: confirms the first motion and motions after a break, and closes or opens the clamp."""

from __future__ import annotations

import json
import socket
import sys
import time
from collections.abc import Callable
from typing import Protocol

from experiments.plans.errors import PlanError
from experiments.runs.errors import RunStopped
from kinematics.host_port import host_and_port as read_address

__all__ = ["Console", "Person", "VirtualOperator", "Yes", "host_and_port"]

Say = Callable[[str], None]
PATIENCE = 10.0  # s for the virtual operator's whole answer
LONGEST_LINE = 65536  # bytes of it
LONGEST_WORDS = 300  # characters of it in a message


class Person(Protocol):
    """Somebody who looks at the robot, and whose hands close the clamp."""

    def confirm(self, facts: str, question: str) -> None:
        """Ask for a yes.

        Raises
        ------
        RunStopped
            It was not given.
        """

    def clamp(self, where: str) -> None:
        """Have the flange clamped; returns when it is. Raises `RunStopped` if it will not be."""

    def release(self) -> None:
        """Have the clamp opened; returns when it is."""


class Console:
    """A person at the terminal."""

    def __init__(self, say: Say) -> None:
        self._say = say

    def confirm(self, facts: str, question: str) -> None:
        """Print what is known, and read an answer; only ``yes`` is a yes."""
        for line in facts.splitlines():
            self._say(line)
        if not sys.stdin.isatty():
            raise RunStopped(f"{question} Nobody is there to answer: give --yes if you have looked at the robot")
        if self._answer(f"{question} [yes/no] ") != "yes":
            raise RunStopped("a person said no")

    def clamp(self, where: str) -> None:
        """Ask for the clamp to be closed."""
        self.confirm(where, "Close the clamp now, without force from the block. Is it closed?")

    def release(self) -> None:
        """Ask for the clamp to be opened."""
        self.confirm("The drives are unwound.", "Open the clamp now. Is it open?")

    def _answer(self, question: str) -> str:
        print(question, end="", file=sys.stderr, flush=True)
        return sys.stdin.readline().strip().lower()


class Yes:
    """Answers yes for a person who has looked; it cannot close a clamp."""

    def __init__(self, say: Say) -> None:
        self._say = say

    def confirm(self, facts: str, question: str) -> None:
        """Say what was confirmed."""
        for line in facts.splitlines():
            self._say(line)
        self._say(f"{question} --yes")

    def clamp(self, where: str) -> None:
        """Nobody is there."""
        raise RunStopped("clamp: --yes has no hands; leave it out, or give --operator HOST:PORT of a virtual robot")

    def release(self) -> None:
        """Nobody is there."""
        raise RunStopped("clamp: --yes has no hands; open it, and resume")


class VirtualOperator:
    """The virtual operator at ``clampid virtual-robot --operator HOST:PORT``; questions go to another `Person`.

    Parameters
    ----------
    address
        ``HOST:PORT``.
    asked
        Who answers questions.
    """

    def __init__(self, address: str, asked: Person) -> None:
        self._where, self._asked = host_and_port(address, "--operator"), asked

    def confirm(self, facts: str, question: str) -> None:
        """Ask the person."""
        self._asked.confirm(facts, question)

    def clamp(self, where: str) -> None:
        """Close the clamp."""
        self._do("clamp")

    def release(self) -> None:
        """Open the clamp."""
        self._do("release")

    def _do(self, line: str) -> None:
        try:
            with socket.create_connection(self._where, PATIENCE) as peer:
                peer.sendall(f"{line}\n".encode())
                answer = json.loads(_line(peer, PATIENCE))
        except (OSError, ValueError, RecursionError) as error:
            raise RunStopped(f"the virtual operator does not answer: {str(error)[:LONGEST_WORDS]}") from None
        if not isinstance(answer, dict):
            raise RunStopped(f"the virtual operator does not answer: expected a JSON object, found {str(answer)[:80]}")
        refusal = str(answer.get("error", ""))[:LONGEST_WORDS]
        if refusal and "already" not in refusal:
            raise RunStopped(f"the virtual operator cannot {line}: {refusal}")


def _line(peer: socket.socket, patience: float) -> bytes:
    """The first line that comes, without its end.

    Raises
    ------
    OSError
        It is not whole within ``patience`` seconds, or the other side hangs up first.
    ValueError
        It is longer than `LONGEST_LINE`.
    """
    end, found = time.monotonic() + patience, bytearray()
    while b"\n" not in found:
        left = end - time.monotonic()
        if left <= 0:
            raise TimeoutError(f"no whole line within {patience:g} s")
        peer.settimeout(left)
        data = peer.recv(4096)
        if not data:
            raise ConnectionError("it hung up")
        found += data
        if len(found) > LONGEST_LINE:
            raise ValueError(f"expected a line of at most {LONGEST_LINE} bytes, found more")
    return bytes(found.partition(b"\n")[0])


def host_and_port(text: str, what: str) -> tuple[str, int]:
    """Read ``HOST:PORT``.

    Raises
    ------
    PlanError
        It is none.
    """
    try:
        return read_address(text)
    except ValueError as error:
        raise PlanError(f"{what}: {error}") from None
