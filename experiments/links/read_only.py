"""Answers of a link that only reads: it moves nothing, so no program is ever under way."""

from __future__ import annotations

import threading

from experiments.links.errors import LinkLostError
from experiments.links.protocol import CannotError, Fate, Program, RefusedError
from experiments.links.values import Status

__all__ = ["ReadOnly", "StatusReader"]


class ReadOnly:
    """The calls of `Link` about motion, of a link that has none.

    Attributes
    ----------
    why
        Why it moves nothing, for people.
    """

    why: str

    def execute(self, program: Program) -> int:
        """Not possible; see `Link`."""
        raise CannotError(self.why)

    def fate(self, program: int) -> Fate:
        """None was sent; see `Link`."""
        raise RefusedError(f"program {program}: this link has sent none")

    def wait(self, program: int, patience: float) -> Fate:
        """None was sent; see `Link`."""
        return self.fate(program)

    def stop(self) -> None:
        """Not possible; see `Link`."""
        raise CannotError(f"stop: {self.why}; use the controller's own stop")

    def release(self) -> None:
        """Not possible; see `Link`."""
        raise CannotError(f"release: {self.why}")

    def confirm(self) -> None:
        """Nothing is ever open; see `Link`."""

    def open_question(self) -> str | None:
        """Nothing is ever open; see `Link`."""
        return None


class StatusReader(ReadOnly):
    """A link whose thread reads one status after another over a connection that it opens again.

    Attributes
    ----------
    silence
        Seconds without an answer, after which a connection counts as dead.
    trouble
        Why there is no connection now; empty: there is one.
    """

    silence: float

    def _begin(self, name: str) -> None:
        """Start the thread, which runs `_run` until `_closing` is set."""
        self._last: Status | None = None
        self._first, self._closing = threading.Event(), threading.Event()
        self.trouble = "not connected yet"
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        raise NotImplementedError

    def status(self) -> Status:
        """The last status; see `Link`."""
        if self._last is None:
            raise LinkLostError(f"no status has come yet: {self.trouble or 'no answer'}")
        return self._last

    def wait_first(self, patience: float) -> None:
        """Wait for the first status; raises `LinkLostError` if none comes."""
        if not self._first.wait(patience):
            self.status()

    def close(self) -> None:
        """Hang up; see `Link`."""
        self._closing.set()
        self._thread.join(self.silence + 3.0)
