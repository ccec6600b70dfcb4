"""Words that may have been meant."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence


def similar(words: Iterable[str], known: Sequence[str]) -> str:
    """`; did you mean ...?` for words that resemble known ones, else an empty text."""
    near = [match for word in words for match in difflib.get_close_matches(word, known, 1)]
    return f"; did you mean {', '.join(near)}?" if near else ""
