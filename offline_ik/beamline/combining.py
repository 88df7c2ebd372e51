"""Several axes, one motion: commands for gamma, delta and radius within a short time are one move of the robot.

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

__all__ = ["AXES", "Batch", "Combined", "MotionError", "why_refused"]

AXES = {"gamma": "gamma_rad", "delta": "delta_rad", "radius": "r_m"}
"""The axes, and what answers call them."""

WINDOW = 0.03  # s within which coordinates that are set belong together
TURNS_OF_THE_LOOP = 20  # of the loop, for what is ready to be set when it lagged behind
LONGEST_MOTION = 3600.0  # s that a motion may take


class MotionError(RefusedError):
    """A motion began and did not arrive: it was stopped, failed, or its end is not known."""


def why_refused(reply: Mapping[str, Any]) -> str:
    """Why a `move` or `simulate` was refused, of its answer."""
    reasons = reply.get("reasons") or reply.get("path", {}).get("reasons") or ["not reachable"]
    return "; ".join(reasons)


class Batch:
    """Coordinates that become one motion.

    Attributes
    ----------
    decided
        Set once the motion has begun, or was refused; the latter is what ``task`` ends with.
    task
        Ends when the motion has, with where that was.
    """

    def __init__(self) -> None:
        self.wanted: dict[str, float] = {}
        self.dropped = False
        self.decided = asyncio.Event()
        self.task: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()

    async def accepted(self) -> None:
        """Wait until it has begun.

        Raises
        ------
        RefusedError, LostError
            Why it has not.
        """
        await self.decided.wait()
        if self.task.done():
            self.task.result()


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
        self._open: Batch | None = None
        self._ahead: set[Batch] = set()
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
        return await asyncio.shield(self.join(**wanted).task)

    def join(self, **wanted: float) -> Batch:
        """The batch that a motion there belongs to; arguments and errors as for :meth:`move`."""
        unknown = set(wanted) - set(AXES)
        if unknown or not wanted or not all(map(math.isfinite, wanted.values())):
            raise RefusedError(f"expected finite coordinates of {', '.join(AXES)}, found {wanted}")
        if self._open is None:
            self._open = Batch()
            self._ahead.add(self._open)
            self._open.task = asyncio.ensure_future(self._run(self._open))
        self._open.wanted.update(wanted)
        return self._open

    async def _run(self, batch: Batch) -> dict[str, Any]:
        try:
            async with self._lock:
                await asyncio.sleep(WINDOW)
                for _ in range(TURNS_OF_THE_LOOP):
                    await asyncio.sleep(0)
                self._close(batch)
                return await self._made(batch)
        finally:
            self._close(batch)
            self._ahead.discard(batch)
            asyncio.get_running_loop().call_soon(batch.decided.set)  # once the task has ended

    async def _made(self, batch: Batch) -> dict[str, Any]:
        base = (await self.questions.ask("robot"))["setpoint"]
        target = {axis: batch.wanted.get(axis, base[name]) for axis, name in AXES.items()}
        if batch.dropped:
            raise MotionError("stopped before it began")
        reply = await self._moves.move(gamma=target["gamma"], delta=target["delta"], r=target["radius"])
        if not reply["moving"]:
            raise RefusedError(why_refused(reply))
        self.motions += 1
        batch.decided.set()
        moved = await self._moves.ask("moved", timeout=LONGEST_MOTION, number=reply["number"])
        ended = moved["ended"] or {"outcome": "unknown", "reason": f"not ended within {LONGEST_MOTION:g} s"}
        if ended["outcome"] != "arrived":
            raise MotionError(": ".join(filter(None, (ended["outcome"], ended["reason"]))))
        return moved

    def _close(self, batch: Batch) -> None:
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
        reply = await self.questions.ask("simulate", gamma=target["gamma"], delta=target["delta"], r=target["radius"])
        if not reply.get("would_move"):
            raise RefusedError(why_refused(reply))
        return reply

    async def robot(self) -> dict[str, Any]:
        """Where the robot is."""
        return await self.questions.ask("robot")

    async def stop(self, own: bool = False) -> None:
        """Stop it at once, and drop what waits; ``own``: only where a motion that was begun here is not over."""
        if own and not self._ahead:
            return
        for batch in self._ahead:
            batch.dropped = True
        await self._stops.ask("stop")

    async def close(self) -> None:
        """End the connections."""
        for line in (self._moves, self.questions, self._stops):
            await line.close()
