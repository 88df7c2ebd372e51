"""Several axes, one motion: what is asked of gamma, delta and radius within a moment is one move of the robot.

A scan over two angles sets one after the other. Each alone would be a motion of the whole robot: on a grid of nine
points that makes twelve motions, through places that nobody asked for. Here the first coordinate that is set opens a
batch. What else is set within :data:`WINDOW`, or while an earlier motion is still under way, joins it. One lock spans
the three axes.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping
from typing import Any

from offline_ik.beamline.line_client import AsyncLine, RefusedError, Server

__all__ = ["AXES", "Combined", "MotionError", "why_refused"]

AXES = {"gamma": "gamma_rad", "delta": "delta_rad", "radius": "r_m"}
"""The axes, and what answers call them."""

WINDOW = 0.03  # s within which coordinates that are set belong together
TURNS = 20  # of the loop, for what is ready to be set when it lagged behind
LONGEST = 3600.0  # s that a motion may take


class MotionError(RefusedError):
    """A motion began and did not arrive: it was stopped, failed, or its end is not known."""


def why_refused(told: Mapping[str, Any]) -> str:
    """Why a `move` or `simulate` was refused, of its answer."""
    reasons = told.get("reasons") or told.get("path", {}).get("reasons") or ["not reachable"]
    return "; ".join(reasons)


class _Batch:
    """Coordinates that become one motion."""

    def __init__(self) -> None:
        self.wanted: dict[str, float] = {}
        self.dropped = False
        self.task: asyncio.Task[dict[str, Any]] | None = None


class Combined:
    """Moves the robot behind a line protocol's server, coordinates combined.

    Parameters
    ----------
    server
        Connections of their own are made for motions, for questions and for stops: none waits for another.
    """

    def __init__(self, server: Server) -> None:
        self._moves, self.questions, self._stops = (AsyncLine(server) for _ in range(3))
        self._lock = asyncio.Lock()
        self._open: _Batch | None = None
        self._ahead: set[_Batch] = set()
        self.motions = 0

    async def move(self, **wanted: float) -> dict[str, Any]:
        """Move to coordinates (of :data:`AXES`; rad, rad, m), the others as they were accepted; where it ended.

        Raises
        ------
        RefusedError
            Nothing moved, or (:class:`MotionError`) it did not arrive.
        LostError
            The server does not answer.
        """
        unknown = set(wanted) - set(AXES)
        if unknown or not wanted or not all(map(math.isfinite, wanted.values())):
            raise RefusedError(f"expected finite coordinates of {', '.join(AXES)}, found {wanted}")
        if self._open is None:
            self._open = _Batch()
            self._ahead.add(self._open)
            self._open.task = asyncio.create_task(self._run(self._open))
        batch = self._open
        batch.wanted.update(wanted)
        assert batch.task is not None
        return await asyncio.shield(batch.task)

    async def _run(self, batch: _Batch) -> dict[str, Any]:
        try:
            async with self._lock:
                await asyncio.sleep(WINDOW)
                for _ in range(TURNS):
                    await asyncio.sleep(0)
                self._close(batch)
                base = (await self.questions.ask("robot"))["setpoint"]
                target = {axis: batch.wanted.get(axis, base[name]) for axis, name in AXES.items()}
                if batch.dropped:
                    raise MotionError("stopped before it began")
                self.motions += 1
                told = await self._moves.move(
                    timeout=LONGEST, gamma=target["gamma"], delta=target["delta"], r=target["radius"], wait=True
                )
        finally:
            self._close(batch)
            self._ahead.discard(batch)
        ended = told.get("ended")
        if ended is None:
            raise RefusedError(why_refused(told))
        if ended["outcome"] != "arrived":
            raise MotionError(": ".join(filter(None, (ended["outcome"], ended["reason"]))))
        return told

    def _close(self, batch: _Batch) -> None:
        if self._open is batch:
            self._open = None

    async def check(self, **wanted: float) -> dict[str, Any]:
        """What a move there would do, without it; the server's own check.

        Raises
        ------
        RefusedError
            It would be refused.
        """
        base = (await self.questions.ask("robot"))["setpoint"]
        target = {axis: wanted.get(axis, base[name]) for axis, name in AXES.items()}
        told = await self.questions.ask("simulate", gamma=target["gamma"], delta=target["delta"], r=target["radius"])
        if not told.get("would_move"):
            raise RefusedError(why_refused(told))
        return told

    async def robot(self) -> dict[str, Any]:
        """Where the robot is."""
        return await self.questions.ask("robot")

    async def stop(self) -> None:
        """Stop it at once, and drop what waits."""
        for batch in self._ahead:
            batch.dropped = True
        await self._stops.ask("stop")

    async def close(self) -> None:
        """End the connections."""
        for line in (self._moves, self.questions, self._stops):
            await line.close()
