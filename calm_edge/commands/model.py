"""`calm-edge model`: list the models, and check whether one runs correctly on this machine."""

from __future__ import annotations

import argparse
import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from calm_edge.commands.console import say
from calm_edge.commands.exit_codes import ERROR, OK

if TYPE_CHECKING:
    from calm_edge.backbones.model_check.check import Report

LIMIT_S = 30.0


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    listed = actions.add_parser(
        "list", help="list the models with the result of `check` on this machine"
    )
    listed.add_argument("--json", action="store_true", help="the list as JSON on stdout")
    check = actions.add_parser("check", help="test a model folder on this machine")
    check.add_argument("name", metavar="NAME", help="a model's name, or the path of its folder")
    check.add_argument("--json", action="store_true", help="the report as JSON on stdout")
    check.add_argument(
        "--limit-s", type=float, default=LIMIT_S, metavar="S", help="longest run in seconds"
    )
    check.add_argument(
        "--memory-mb", type=float, metavar="MB", help="memory limit (default: 60 %% of free)"
    )
    check.add_argument(
        "--size", type=_size, default=(1280, 720), metavar="WxH", help="size of camera images"
    )


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    width, height = map(int, found.groups()) if found else (0, 0)
    if min(width, height) < 16:
        raise argparse.ArgumentTypeError(f"{text!r}: expected WIDTHxHEIGHT, at least 16x16")
    return width, height


def run(arguments: argparse.Namespace) -> int:
    """List the models, or check one; return 1 if it fails the check."""
    return _list(arguments) if arguments.action == "list" else _check(arguments)


def _list(arguments: argparse.Namespace) -> int:
    from calm_edge.backbones.base import BackboneError
    from calm_edge.backbones.onnx import verdict
    from calm_edge.backbones.onnx.model_folder import find_model, model_names, read_manifest

    rows: list[dict[str, object]] = []
    for name in model_names():
        try:
            manifest = read_manifest(find_model(name))
        except BackboneError as error:
            rows.append({"name": name, "error": str(error)})
            continue
        found = verdict.load(manifest)
        rows.append(
            {
                "name": name,
                "kind": manifest.kind,
                "precisions": manifest.precisions(),
                "license": manifest.license,
                # null: not checked on this machine
                "passed": None if found is None else not found.refusal,
                "result": found and (found.refusal or found.why),
            }
        )
    print(json.dumps({"models": rows}, indent=1) if arguments.json else _table(rows))
    return OK


def _table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Format the list of models, a line each."""
    lines = []
    for row in rows:
        if "error" in row:
            lines.append(f"{row['name']:14} {row['error']}")
            continue
        result = "not checked here"
        if row["passed"] is not None:
            result = (
                f"passed; runs {row['result']}" if row["passed"] else f"refused: {row['result']}"
            )
        precisions = "/".join(row["precisions"])
        lines.append(
            f"{row['name']:14} {row['kind']:11} {precisions:14} {row['license']:14} {result}"
        )
    return "\n".join(lines)


def _check(arguments: argparse.Namespace) -> int:
    from calm_edge.backbones.model_check.check import check
    from calm_edge.backbones.model_check.probe import MEMORY_SHARE, Limits, free_memory_mb
    from calm_edge.backbones.onnx import verdict
    from calm_edge.backbones.onnx.model_folder import find_model, read_manifest

    manifest = read_manifest(find_model(arguments.name))
    memory_mb = arguments.memory_mb
    if memory_mb is None:
        memory_mb = MEMORY_SHARE * free_memory_mb()
    limits = Limits(arguments.limit_s, memory_mb, arguments.size)
    # with --json print only the JSON object
    tell = (lambda _: None) if arguments.json else say
    report = check(manifest, limits, tell)
    path = verdict.save(manifest, report.verdict())
    print(json.dumps(_plain(report), indent=1) if arguments.json else _text(report))
    tell(f"result saved in {path}")
    return ERROR if report.refusal else OK


def _plain(report: Report) -> dict[str, object]:
    """Convert a report to a JSON object, with null for numbers that are not finite."""
    import dataclasses

    def clean(value: object) -> object:
        if isinstance(value, dict):
            return {key: clean(part) for key, part in value.items()}
        if isinstance(value, list):
            return [clean(part) for part in value]
        if isinstance(value, float) and not math.isfinite(value):
            return None
        return value

    from calm_edge.backbones.onnx.verdict import machine

    plain = {key: clean(value) for key, value in dataclasses.asdict(report).items()}
    return plain | {"passed": not report.refusal, "machine": machine()}


def _text(report: Report) -> str:
    """Format a report as a table."""
    lines = [f"files        {report.files} with the hashes of the manifest"] if report.files else []
    worst: dict[tuple[str, str], tuple[float, float]] = {}
    for row in report.compared:
        key = (row.precision, row.case)
        worst[key] = max(worst.get(key, (0.0, 0.0)), (row.deviation, row.tolerance))
    for (precision, case), (off, tolerance) in worst.items():
        lines.append(f"golden       {precision} {case}: off by {off:.2g} of {tolerance:g} allowed")
    for where, seen in report.reprojection.items():
        lines.append(
            f"reprojection {where}: depth of views differs by {seen.disagreement:.1%} "
            f"({seen.inverted:.1%} with inverted poses), {seen.covisible:.0%} covisible"
        )
    for run in report.measured:
        what = run.what or f"{run.views} views"
        lines.append(
            f"run          {run.precision} {what}: {run.seconds:.3f} s, {run.peak_mb:.0f} MB"
        )
    lines += [f"ended        {precision}: {why}" for precision, why in report.ended.items()]
    if report.refusal:
        lines.append(f"refused      {report.refusal}")
    else:
        lines.append(f"runs         {report.why}")
        lines.append(f"views a run  {report.max_views[report.precision]}")
    return "\n".join(lines)
