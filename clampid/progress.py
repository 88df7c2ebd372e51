"""How far a long piece of work has come: named parts within parts, each a share of the one around it.

Library functions say what they do with :func:`substep` and :func:`in_parts`. Where nobody listens, both do nothing. A
verb listens with :func:`listen`. Shares are estimates: they make a time left good to a factor of two, no more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

__all__ = ["Listener", "Remaining", "in_parts", "innermost", "left_in_words", "listen", "substep", "time_left"]

T = TypeVar("T")
Listener = Callable[[float, str], None]
"""Takes the share that is done (0 to 1) and the names of the parts that are under way, outermost first."""

SOON = 4.0  # seconds
SHORTEST_PART = 0.5  # seconds
_WITHIN = ": "  # between the name of a part and that of a part of it
LEAST_DONE = 0.05  # below which the time left is anybody's guess


class _Tracker:
    """The parts that are under way: their names, where each ends, and how far it has come, 0 to 1."""

    def __init__(self, listener: Listener) -> None:
        self.listener, self.names, self.ends, self.done = listener, list[str](), [1.0], 0.0

    def begin(self, name: str, share: float) -> None:
        self.ends.append(self.done + share * (self.ends[-1] - self.done))
        self.names.append(name)
        self.listener(self.done, _WITHIN.join(filter(None, self.names)))

    def end(self) -> None:
        self.done = self.ends.pop()
        self.names.pop()


_tracker: ContextVar[_Tracker | None] = ContextVar("tracker", default=None)


@contextmanager
def listen(listener: Listener) -> Iterator[None]:
    """Hear of every part that begins within."""
    token = _tracker.set(_Tracker(listener))
    try:
        yield
    finally:
        _tracker.reset(token)


@contextmanager
def substep(name: str, share: float = 0.5) -> Iterator[None]:
    """One part of a piece of work: a share of what is left of the part around it. Decorates functions, too."""
    tracker = _tracker.get()
    if tracker is None:
        yield
        return
    tracker.begin(name, share)
    try:
        yield
    finally:
        tracker.end()


def in_parts(
    items: Iterable[T], name: Callable[[T], str] = lambda _: "", weight: Callable[[T], float] = lambda _: 1.0
) -> Iterator[T]:
    """Go through items, each a part of what is left by its weight; ``name`` names the part of one."""
    several = list(items)
    weights = [weight(item) for item in several]
    for k, item in enumerate(several):
        with substep(name(item), weights[k] / sum(weights[k:])):
            yield item


def innermost(work: str, names: str, width: int) -> str:
    """What is under way, ``work`` and the ``names`` of its parts, without the outer ones that do not fit the width."""
    parts = [work, *filter(None, names.split(_WITHIN))]
    while len(parts) > 1 and len(_WITHIN.join(parts)) > width:
        parts.pop(0)
    return _WITHIN.join(parts)


def time_left(done: float, elapsed: float) -> float | None:
    """Seconds left after ``elapsed`` of them; None where too little is done to tell."""
    return None if done < LEAST_DONE else elapsed * (1.0 - done) / done


class Remaining:
    """The time left of work whose number of parts nobody knows, such as rounds of a search.

    The shares of such parts shrink, and the time left would say "a few seconds" for minutes. So it is never less than
    the part took that ended last.
    """

    def __init__(self) -> None:
        self._last, self._part = 0.0, 0.0

    def words(self, done: float, elapsed: float) -> str:
        """As :func:`left_in_words`, where a part begins ``elapsed`` seconds after the work did."""
        took, self._last = elapsed - self._last, elapsed
        self._part = took if took >= SHORTEST_PART else self._part  # a part within a part begins with it
        return left_in_words(done, elapsed, self._part)


def left_in_words(done: float, elapsed: float, least: float = 0.0) -> str:
    """``, about 40 s left``; empty where too little is done to tell. ``least``: seconds that are left at least."""
    left = time_left(done, elapsed)
    if left is None:
        return ""
    left = max(left, least)
    if left < SOON:
        return ", a few seconds left"
    return f", about {left:.0f} s left" if left < 90 else f", about {left / 60:.0f} min left"
