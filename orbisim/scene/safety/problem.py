"""What is wrong with a mesh file."""

from __future__ import annotations


class MeshProblemError(Exception):
    """What is wrong with a mesh file; the caller adds which file it is and who referred to it.

    Args:
      problem: what is wrong. remedy: what to do, where it is more than to replace the file.
    """

    def __init__(self, problem: str, remedy: str | None = None) -> None:
        super().__init__(problem)
        self.remedy = remedy
