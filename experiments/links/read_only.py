"""What a link answers that only reads: it moves nothing, so that nothing is ever on its way or open."""

from __future__ import annotations

from experiments.links.protocol import CannotError, Fate, Program, RefusedError

__all__ = ["ReadOnly"]


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
