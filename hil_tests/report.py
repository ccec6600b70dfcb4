"""Rows of results, and the table of them that a user can send in."""

from __future__ import annotations

import json
import platform
import textwrap
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path

import calm_edge


class Verdict(StrEnum):
    """The result of a row. SKIP: what the test needs is not present; the row's text says what."""

    PASS = "pass"
    FAIL = "FAIL"
    SKIP = "skip"


@dataclass(frozen=True, slots=True)
class Row:
    """The result of one check. seen: the measurement. wanted: what passes."""

    test: str
    what: str
    verdict: Verdict
    seen: str
    wanted: str = ""


def judged(test: str, what: str, good: bool, seen: str, wanted: str) -> Row:
    """Make a row that passes when `good`."""
    return Row(test, what, Verdict.PASS if good else Verdict.FAIL, seen, wanted)


def skipped(test: str, what: str, why: str) -> Row:
    """Make a row for what could not be checked."""
    return Row(test, what, Verdict.SKIP, why)


def machine() -> dict[str, str]:
    """Describe the machine, without anything that identifies its owner."""
    model = Path("/proc/device-tree/model")
    cpu = [x for x in Path("/proc/cpuinfo").read_text().splitlines() if x.startswith("model name")]
    named = model.read_text().strip("\0\n") if model.exists() else ""
    return {
        "calm-edge": calm_edge.__version__,
        "machine": named or (cpu[0].partition(":")[2].strip() if cpu else platform.machine()),
        "kernel": f"{platform.release()} {platform.machine()}",
        "python": platform.python_version(),
        "date": time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime()),
    }


def text_of(rows: Sequence[Row]) -> str:
    """Format the table."""
    widths = [max((len(getattr(r, k)) for r in rows), default=0) for k in ("test", "what")]
    lines = [f"{key:10} {value}" for key, value in machine().items()]
    lines.append("")
    for row in rows:
        wanted = f"  [{row.wanted}]" if row.wanted else ""
        head = f"{row.verdict:4}  {row.test:{widths[0]}}  {row.what:{widths[1]}}  "
        text = f"{row.seen}{wanted}"
        lines += textwrap.wrap(head + text, 120, subsequent_indent=" " * 8) or [head]
    counts = [f"{sum(r.verdict is v for r in rows)} {v}" for v in Verdict]
    return "\n".join([*lines, "", ", ".join(counts)]) + "\n"


def write(rows: Sequence[Row], folder: Path) -> tuple[Path, Path]:
    """Write report.txt and report.json into the folder; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    text, data = folder / "report.txt", folder / "report.json"
    text.write_text(text_of(rows))
    data.write_text(json.dumps({**machine(), "rows": [asdict(r) for r in rows]}, indent=1) + "\n")
    return text, data
