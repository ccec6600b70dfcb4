from __future__ import annotations

import runpy
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def test_the_drawing_in_the_documentation_is_up_to_date() -> None:
    drawn = runpy.run_path(str(DOCS / "frames.py"))["page"]()
    assert drawn == (DOCS / "frames.svg").read_text(), "run docs/frames.py"
