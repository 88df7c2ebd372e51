"""The queues of a channel in EthernetKRL: one for each element, with a common maximum length."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

from experiments.virtual_controller.config import Config
from experiments.virtual_controller.documents import Value

__all__ = ["Fifos"]


class Fifos:
    """The queues of one channel.

    A record is taken only when every queue has a value: a document without some element leaves the record waiting, and
    the next document fills it. Programs that read such a channel therefore check what belongs together.
    """

    def __init__(self, config: Config) -> None:
        self._limit = config.limit
        self._queues: dict[str, deque[Value]] = {tag.path: deque() for tag in config.receive}

    def store(self, document: Mapping[str, Value]) -> bool:
        """Store what a document brings; False if a queue was full, which closes the connection."""
        for path, value in document.items():
            queue = self._queues[path]
            if len(queue) >= self._limit:
                return False
            queue.append(value)
        return True

    def take(self) -> dict[str, Value] | None:
        """Give the oldest value of every element, or None where one has none."""
        if not all(self._queues.values()):
            return None
        return {path: queue.popleft() for path, queue in self._queues.items()}

    def clear(self) -> None:
        """Forget everything: ``EKI_Clear``."""
        for queue in self._queues.values():
            queue.clear()

    @property
    def stored(self) -> int:
        """Values in the longest queue."""
        return max(len(queue) for queue in self._queues.values())
