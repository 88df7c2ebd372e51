"""The ring buffer of samples on the controller; a sample is computed on request."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass

from experiments.virtual_controller.arm import SAMPLE_S, Arm, Readings

__all__ = ["RING", "Recording", "Sample"]

RING = 20_000  # samples that are kept
BLOCK = 32  # samples that are worked out together
BLOCKS_KEPT = 64  # blocks


@dataclass(frozen=True)
class Sample:
    """One sample: its number, the controller's clock in s, and what was read: deg, Nm, A, (6,) each."""

    number: int
    time: float
    axis: tuple[float, ...]
    torque: tuple[float, ...]
    current: tuple[float, ...]


class Recording:
    """Samples from 1 on, each `SAMPLE_S` seconds, since the controller's programs were started.

    Parameters
    ----------
    arm
        What is read.
    since
        When they were started, s.
    """

    def __init__(self, arm: Arm, since: float) -> None:
        self._arm, self.since = arm, since
        self._blocks: OrderedDict[int, list[Sample]] = OrderedDict()
        self._off: list[tuple[float, float]] = []  # when the drives were without power, s

    def newest(self, now: float) -> int:
        """Return the number of the last sample; 0 before the first."""
        return max(math.floor((now - self.since) / SAMPLE_S + 1e-9), 0)

    def oldest(self, now: float) -> int:
        """Return the number of the oldest sample that is still there."""
        return max(self.newest(now) - RING + 1, 1)

    def power(self, on: bool, now: float) -> None:
        """Remember that the drives were switched on or off."""
        if on and self._off and self._off[-1][1] == math.inf:
            self._off[-1] = (self._off[-1][0], now)
        elif not on and not (self._off and self._off[-1][1] == math.inf):
            self._off.append((now, math.inf))
        self._off = [span for span in self._off if span[1] > now - RING * SAMPLE_S]

    def samples(self, first: int, count: int, now: float) -> list[Sample]:
        """Return at most ``count`` samples that are there, from number ``first`` on."""
        begin, newest = max(first, self.oldest(now)), self.newest(now)
        found: list[Sample] = []
        while len(found) < count and begin <= newest:
            block = begin // BLOCK
            if (block + 1) * BLOCK - 1 <= newest:
                rows = self._block(block)[begin % BLOCK - (1 if block == 0 else 0) :]
            else:
                rows = self._work_out(list(range(begin, min(newest, begin + count - 1) + 1)))
            found += rows[: count - len(found)]
            begin = found[-1].number + 1
        return found

    def _block(self, number: int) -> list[Sample]:
        """A block that has passed whole."""
        if number not in self._blocks:
            first = max(number * BLOCK, 1)
            self._blocks[number] = self._work_out(list(range(first, (number + 1) * BLOCK)))
            if len(self._blocks) > BLOCKS_KEPT:
                self._blocks.popitem(last=False)
        self._blocks.move_to_end(number)
        return self._blocks[number]

    def _work_out(self, numbers: list[int]) -> list[Sample]:
        times = [self.since + SAMPLE_S * number for number in numbers]
        on = self._arm.read(times, numbers)
        off = Readings(on.axis, 0.0 * on.torque, 0.0 * on.current)
        out = []
        for i, (number, time) in enumerate(zip(numbers, times, strict=True)):
            read = off if any(start <= time < end for start, end in self._off) else on
            out.append(
                Sample(number, time, *(tuple(map(float, part[i])) for part in (read.axis, read.torque, read.current)))
            )
        return out
