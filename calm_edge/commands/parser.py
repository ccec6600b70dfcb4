"""Parser of the command line that suggests what may have been meant."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

from calm_edge.similar import similar

_CHOICE = re.compile(r"invalid choice: '(.*?)' \(choose from (.*)\)")


class Parser(argparse.ArgumentParser):
    """An ArgumentParser whose errors name similar commands, options or choices.

    Options must be written in full, so that a later option cannot change what a script means.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **{"allow_abbrev": False, **options})
        self._given: list[str] = []

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse; arguments left over are an error of this parser, which knows its options."""
        self._given = list(sys.argv[1:] if args is None else args)
        found, left = super().parse_known_args(args, namespace)
        if left:
            self.error(f"unrecognized arguments: {' '.join(left)}{self._similar_options(left)}")
        return found, left

    def error(self, message: str) -> NoReturn:
        """Print usage and the error, with suggestions, and exit with 2."""
        if found := _CHOICE.search(message):
            choices = [choice.strip("'") for choice in found[2].split(", ")]
            message += similar([found[1]], choices)
        if "required" in message:
            # a misspelt option may be the one that is missed
            message += self._similar_options(self._given)
        super().error(message)

    def _similar_options(self, words: Iterable[str]) -> str:
        known = [option for action in self._actions for option in action.option_strings]
        given = [word.partition("=")[0] for word in words if word.startswith("--")]
        return similar([option for option in given if option not in known], known)
