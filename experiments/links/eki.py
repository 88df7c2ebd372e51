"""A KUKA controller with EthernetKRL and the programs of ``clampid link-files``: ``eki://HOST:PORT``.

The link never sends a program twice. It believes that one moves, or has finished, only where the controller says so.
"""

from __future__ import annotations

import time

import numpy as np

from experiments.links.address import LinkAddress
from experiments.links.eki_motion import MotionChannel, documents_of
from experiments.links.eki_state import StateChannel, status_of
from experiments.links.programs import Programs
from experiments.links.protocol import (
    UNKNOWN_UNIT,
    Capabilities,
    Fate,
    LinkLostError,
    Program,
    Recording,
    RefusedError,
    Signal,
    Status,
)
from experiments.links.schema import AXES, LONGEST_PROGRAM, SAMPLE_MS, SAMPLES, STATE, Kind

__all__ = ["EkiLink", "connect"]

FIRST_STATUS_TIMEOUT = 3.0  # s within which the first status has to come
PATIENCE = 10.0  # s within which the fate of a program has to be learned
PAUSE = 0.02  # s between two attempts
LONGEST_PATIENCE = 600.0
TIMER = "controller, $TIMER"


class EkiLink:
    """One robot over two channels.

    Parameters
    ----------
    host, port
        Of the motion channel; the state channel has the next port.
    torque, current
        Units of $TORQUE_AXIS_ACT and of $CURR_ACT, where known.
    patience
        Within which the fate of a program has to be learned, s.
    """

    def __init__(
        self,
        host: str,
        port: int,
        torque: str = UNKNOWN_UNIT,
        current: str = UNKNOWN_UNIT,
        patience: float = PATIENCE,
    ) -> None:
        period = SAMPLE_MS / 1000
        self.capabilities = Capabilities(
            scheme="eki",
            executes=True,
            stops=True,
            releases=True,
            records=True,
            stops_at_once=True,
            begins_at_once=True,
            longest_program=LONGEST_PROGRAM,
            signals=(
                Signal("joint", "rad", "joint", "measured", TIMER, period),
                Signal("torque", torque, "motor", "measured", TIMER, period),
                Signal("current", current, "motor", "measured", TIMER, period),
                Signal("temperature", "degC", "motor", "measured", TIMER, None),
            ),
            cannot=("Motor angles: the controller has no variable of them.",),
        )
        self._programs = Programs(patience)
        self._state = StateChannel(host, port + STATE.offset, self._programs.seen, self._programs.tick)
        self._motion = MotionChannel(host, port, self._programs, self._fresh, self._state.hurry)

    def _fresh(self) -> Status:
        return status_of(self._state.exchange(Kind.STATE))

    def wait_connected(self, patience: float) -> None:
        """Wait for the first status, and for the motion channel, without which the link can still read.

        Raises
        ------
        LinkLostError
            No status came within the patience, s.
        """
        end = time.monotonic() + patience
        self._state.wait_first(patience)
        while not self._motion.ready and self._motion.attempts < 2 and time.monotonic() < end:
            time.sleep(PAUSE)

    def status(self) -> Status:
        """The last status; see `Link`."""
        if self._state.last is None:
            raise LinkLostError(f"no status has come yet: {self._state.trouble or 'no answer'}")
        return self._state.last

    def trouble(self) -> dict[str, str]:
        """What is wrong with the channels now, in words; an empty text: nothing."""
        return {"motion": self._motion.trouble, "state": self._state.trouble}

    def execute(self, program: Program) -> int:
        """Begin a program; see `Link`."""
        if program.postures.shape[1] != AXES:
            raise RefusedError(f"program: expected {AXES} joints, found {program.postures.shape[1]}")
        if len(program.postures) > LONGEST_PROGRAM:
            raise RefusedError(f"program: expected at most {LONGEST_PROGRAM} points, found {len(program.postures)}")
        stops = self._motion.stops
        if self._state.stop_wanted:
            raise RefusedError("a stop is on its way to the controller")
        if not self._motion.ready:
            raise LinkLostError(f"motion channel: {self._motion.trouble or 'not ready yet'}")
        status = self.status()
        fate = self._programs.begin(status, len(program.postures))
        self._motion.queue(fate.id, documents_of(program, status.boot or 0, fate.id), stops)
        return fate.id

    def fate(self, program: int) -> Fate:
        """What is known of it; see `Link`."""
        return self._programs.fate(program)

    def wait(self, program: int, patience: float) -> Fate:
        """Wait until it has ended; see `Link`."""
        return self._programs.wait(program, patience)

    def stop(self) -> None:
        """Stop at once; see `Link`."""
        self._motion.stopped()
        self._state.stop()

    def release(self) -> None:
        """Lift the stop; see `Link`."""
        if self._state.stop_wanted:
            raise RefusedError("release: the controller has not acknowledged the stop yet")
        if self.status().running:
            raise RefusedError(f"release: program {self.status().running} is running")
        self._state.release()

    def confirm(self) -> None:
        """A person has looked; see `Link`."""
        self._programs.confirm()

    def open_question(self) -> str | None:
        """What a person has to look at; see `Link`."""
        return self._programs.question

    def recording(self, start: int, most: int = 1000, patience: float = 5.0) -> Recording:
        """Samples from a number on; see `Link`.

        Raises
        ------
        LinkLostError
            The controller does not answer, or its programs were started again: its numbers begin anew then.
        """
        end, following, boot = time.monotonic() + patience, max(start, 1), self.status().boot
        rows: list[tuple[float, ...]] = []
        lost: tuple[int, int] | None = None
        while True:
            try:
                values = self._state.exchange(Kind.RECORDING, following)
            except LinkLostError:  # what the controller has recorded is there after the break, too
                if time.monotonic() > end:
                    raise
                time.sleep(PAUSE)
                continue
            status = status_of(values)
            if status.boot != boot:
                raise LinkLostError("recording: the controller's programs were started again; its numbers begin anew")
            oldest, newest = status.oldest or 0, status.newest or 0
            if following < oldest:
                lost = (following if lost is None else lost[0], oldest - 1)
                following = oldest
            for k in range(1, min(int(values["Robot/Samples/@Count"]), SAMPLES) + 1):
                row = tuple(values[f"Robot/S{k}/@{name}"] for name in _SAMPLE)
                if row[0] == following and len(rows) < most:
                    rows.append(row)
                    following += 1
            if len(rows) >= most or following > newest or time.monotonic() > end:
                break
        found = np.array(rows, dtype=np.float64).reshape(-1, len(_SAMPLE))
        parts = [found[:, 2 + AXES * k : 2 + AXES * (k + 1)] for k in range(3)]
        return Recording(
            found[:, 0].astype(np.int64), found[:, 1] / 1000, np.radians(parts[0]), parts[1], parts[2], lost, newest
        )

    def close(self) -> None:
        """Hang up; see `Link`."""
        self._motion.close()
        self._state.close()


_SAMPLE = ("N", "T", *(f"{letter}{k}" for letter in "QMI" for k in range(1, AXES + 1)))


def connect(address: LinkAddress) -> EkiLink:
    """Connect; settings are ``torque`` (Nm or %), ``current`` (A or %), ``patience`` (s).

    Raises
    ------
    LinkLostError
        The state channel does not answer.
    """
    chosen = address.chosen(torque=("Nm", "%"), current=("A", "%"), patience=None)
    patience = address.seconds("patience", PATIENCE, LONGEST_PATIENCE)
    link = EkiLink(
        address.host,
        address.port,
        chosen.get("torque", UNKNOWN_UNIT),
        chosen.get("current", UNKNOWN_UNIT),
        patience,
    )
    try:
        link.wait_connected(FIRST_STATUS_TIMEOUT)
    except LinkLostError:
        link.close()
        raise
    return link
