"""Tables of measurements: printed, stored as JSON under build/eval, and joined on one page."""

from __future__ import annotations

import argparse
import html
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from calm_edge.evaluation.table import aligned, pretty
from calm_edge.report import page
from calm_edge.types import CalmEdgeError

OUT = Path("build") / "eval"
FOLDER = "tables"


class TableError(CalmEdgeError):
    """A stored table cannot be read."""


@dataclass(frozen=True, slots=True)
class Check:
    """One requirement: quantity, target, measured value, and whether the value meets the target."""

    what: str
    asked: str
    measured: Any
    passed: bool


@dataclass(frozen=True, slots=True)
class Table:
    """Table of a measurement.

    name: of its file, also the sort key on the page. command: command line that makes the table.
    rows: values in order of columns, None if missing. checks: requirements on the values. notes:
    conditions of the measurement.
    """

    name: str
    title: str
    command: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    checks: tuple[Check, ...] = ()
    notes: tuple[str, ...] = ()


def print_rows(columns: Sequence[str], rows: Sequence[Sequence[Any]], title: str = "") -> None:
    """Print a table with a header to stdout."""
    print("\n".join([*([title] if title else []), *aligned(rows, columns)]))


def publish(table: Table, out: Path = OUT) -> int:
    """Print a table and write it to `out`/tables/NAME.json; return 1 if a requirement is missed."""
    print_rows(table.columns, table.rows, table.title)
    if table.checks:
        rows = [(c.what, c.asked, c.measured, c.passed) for c in table.checks]
        print_rows(("what", "target", "measured", "met"), rows)
    for note in table.notes:
        print(f"  {note}")
    folder = out / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(_plain(asdict(table)), indent=1, allow_nan=False)
    (folder / f"{table.name}.json").write_text(text + "\n")
    return exit_code([table])


def exit_code(tables: Iterable[Table]) -> int:
    """1 if a requirement of any table is not met, else 0."""
    return int(not all(check.passed for table in tables for check in table.checks))


def kept(out: Path = OUT) -> list[Table]:
    """Read all stored tables, in order of name; raises TableError."""
    found = []
    for file in sorted((out / FOLDER).glob("*.json")):
        try:
            fields: dict[str, Any] = json.loads(file.read_text())
            fields["rows"] = tuple(tuple(row) for row in fields["rows"])
            fields["checks"] = tuple(Check(**check) for check in fields["checks"])
            fields |= {key: tuple(fields[key]) for key in ("columns", "notes")}
            found.append(Table(**fields))
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise TableError(f"{file}: not a table ({error}); remove it") from None
    return found


def render(tables: Iterable[Table]) -> str:
    """HTML page of all tables, with a list of all requirements first."""
    tables = list(tables)
    checks = [(table, check) for table in tables for check in table.checks]
    broken = sum(not check.passed for _, check in checks)
    lead = (
        f"{len(checks)} requirements, {len(checks) - broken} met" if checks else "no requirements"
    )
    parts = [f'<h1>calm-edge, measured</h1><p class="lead">{lead}</p>']
    if checks:
        rows = [(t.title, c.what, c.asked, c.measured, c.passed) for t, c in checks]
        body = _html_table(("table", "what", "target", "measured", "met"), rows)
        parts.append(page.section("Requirements", "", body))
    for table in tables:
        notes = "".join(f"<li>{html.escape(note)}</li>" for note in table.notes)
        body = _html_table(table.columns, table.rows) + (f"<ul>{notes}</ul>" if notes else "")
        command = f"<p><code>{html.escape(table.command)}</code></p>"
        parts.append(page.section(table.title, "", command + body))
    return page.whole("calm-edge, measured", parts)


def _html_table(columns: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    head = "".join(f"<th>{html.escape(name)}</th>" for name in columns)
    body = "".join(f"<tr>{''.join(_cell(value) for value in row)}</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def _cell(value: Any) -> str:
    kind = {True: ' class="good"', False: ' class="bad"'}[value] if isinstance(value, bool) else ""
    return f"<td{kind}>{html.escape(pretty(value))}</td>"


def _plain(value: Any) -> Any:
    """Convert a value for JSON: NaN and infinity, which JSON lacks, become None."""
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value.item() if hasattr(value, "item") else value


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Write report.html and report.json of the stored tables; return 1 for a missed requirement."""
    out = options.out
    tables = kept(out)
    out.mkdir(parents=True, exist_ok=True)
    (out / "report.html").write_text(render(tables), encoding="utf-8")
    (out / "report.json").write_text(json.dumps(_plain([asdict(t) for t in tables]), indent=1))
    print(f"report  {out / 'report.html'} ({len(tables)} tables)")
    return exit_code(tables)
