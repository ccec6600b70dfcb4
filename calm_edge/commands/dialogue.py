"""Questions to the user, and their answers: typed in a terminal, or the proposed ones."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TypeVar

from calm_edge.types import CalmEdgeError

T = TypeVar("T")


class DialogueError(CalmEdgeError):
    """There is nobody to answer."""


class Dialogue:
    """Asks on stderr and reads from stdin; with `silent`, every proposal is the answer."""

    def __init__(self, *, silent: bool) -> None:
        self._silent = silent

    @property
    def silent(self) -> bool:
        """Whether nobody is asked."""
        return self._silent

    def say(self, text: str) -> None:
        """Print a line."""
        print(text, file=sys.stderr, flush=True)

    def ask(self, question: str, proposal: str, read: Callable[[str], T]) -> T:
        """Ask until `read` accepts the answer; an empty one is the proposal.

        read: converts the text, raises ValueError with what is wrong.
        """
        if self._silent:
            self.say(f"{question}: {proposal or 'none'}")
            return read(proposal)
        while True:
            text = self._typed(f"{question} [{proposal}]: ") or proposal
            try:
                return read(text)
            except ValueError as error:
                self.say(f"  {error}")

    def confirm(self, question: str, proposal: bool) -> bool:
        """Ask for yes or no."""
        words = {"y": True, "yes": True, "n": False, "no": False}

        def read(text: str) -> bool:
            if text.lower() not in words:
                raise ValueError("yes or no")
            return words[text.lower()]

        return self.ask(question, "yes" if proposal else "no", read)

    def _typed(self, prompt: str) -> str:
        print(prompt, end="", file=sys.stderr, flush=True)
        line = sys.stdin.readline()
        if not line:
            raise DialogueError("the input ended before all was answered; nothing was written")
        return line.strip()


def opened(*, yes: bool) -> Dialogue:
    """The dialogue with the user; raises DialogueError if nobody is there and not `yes`."""
    if not yes and not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise DialogueError(
            "this asks questions: run it in a terminal (ssh -t), or add --yes and give what is "
            "not proposed by options"
        )
    return Dialogue(silent=yes)
