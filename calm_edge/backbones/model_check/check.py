"""Checks of `calm-edge model check`: correctness, time and memory of a model on this machine.

In order: file hashes, golden values, plausibility of the decoded outputs, time and memory. The
first failure ends the check and is the refusal; earlier measurements stay in the report.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.feedforward.decode.decoder import decode
from calm_edge.backbones.model_check import probe, sanity
from calm_edge.backbones.model_check.golden import Case, deviation, fits_of, read_cases
from calm_edge.backbones.model_check.probe import Limits, Measured
from calm_edge.backbones.model_check.sanity import Reprojection
from calm_edge.backbones.onnx.manifest import Manifest, ManifestError, Precision
from calm_edge.backbones.onnx.model_folder import verify
from calm_edge.backbones.onnx.session import Session, Tensor
from calm_edge.backbones.onnx.verdict import Verdict

# A lower precision is chosen only if its time is below this share of the highest one's.
WORTH_IT = 0.9


@dataclass(frozen=True, slots=True)
class Compared:
    """Error of an output against its golden value, as `golden.deviation`, and its tolerance."""

    precision: Precision
    case: str
    output: str
    deviation: float
    tolerance: float


@dataclass(slots=True)
class Report:
    """Results of all checks, in order. refusal: reason of the failure, empty on success.

    files: number of verified files. ended: reason why no larger number of views was measured, by
    precision. max_views: maximum per run on this machine, by precision. why: reason for the choice
    of precision.
    """

    name: str
    files: int = 0
    compared: list[Compared] = field(default_factory=list)
    reprojection: dict[str, Reprojection] = field(default_factory=dict)
    measured: list[Measured] = field(default_factory=list)
    ended: dict[Precision, str] = field(default_factory=dict)
    max_views: dict[str, int] = field(default_factory=dict)
    precision: Precision = "fp32"
    why: str = ""
    refusal: str = ""

    def verdict(self) -> Verdict:
        """Verdict for the cache, which is read when the model is opened."""
        return Verdict(self.refusal, self.precision, self.max_views, self.why)


def check(manifest: Manifest, limits: Limits, say: Callable[[str], None]) -> Report:
    """Run all checks; a failure is in `Report.refusal`. say: called with each step's name."""
    report = Report(manifest.name, precision=manifest.precisions()[0])
    try:
        say("hashes")
        report.files = verify(manifest)
        cases = read_cases(manifest)
        for precision in manifest.precisions():
            say(f"golden values in {precision}")
            _compare(manifest, precision, cases, report)
        for precision in manifest.precisions():
            say(f"time and memory in {precision}")
            _measure(manifest, precision, cases, limits, report)
        _choose(manifest, report)
    except BackboneError as error:
        report.refusal = str(error)
    return report


def _compare(manifest: Manifest, precision: Precision, cases: list[Case], report: Report) -> None:
    tolerance = manifest.golden.tolerance(precision)
    sessions: dict[str, Session] = {}
    for role, graph in manifest.graphs.items():
        needs = [*graph.outputs, *(manifest.output.names() if manifest.output else ())]
        sessions[role] = Session(
            manifest.graph_path(role, precision), needs_inputs=graph.inputs, needs_outputs=needs
        )
    for case in cases:
        where = f"{case.role}/{case.name}"
        found = sessions[case.role].run(case.inputs)
        for name, expected in case.outputs.items():
            if name not in found:
                raise ManifestError(f"golden values: {where}: the graph has no output {name!r}")
            off = deviation(found[name], expected)
            report.compared.append(Compared(precision, where, name, off, tolerance))
            if off > tolerance:
                raise ManifestError(
                    f"golden values: {precision} {where}: {name} is off by {off:.3g} of its RMS, "
                    f"more than {tolerance:g}; shape {found[name].shape}, "
                    f"expected {expected.shape}"
                )
        _sane(manifest, precision, case, found, report)


def _sane(
    manifest: Manifest,
    precision: Precision,
    case: Case,
    found: dict[str, Tensor],
    report: Report,
) -> None:
    if manifest.output is None:
        return
    where = f"{precision} {case.role}/{case.name}"
    try:
        fits = fits_of(manifest, case)
        sanity.check_numbers(manifest.output, found)
        decoded = decode(manifest.output, found, fits)
        sanity.check_poses(decoded)
        if manifest.golden.scene:
            report.reprojection[where] = sanity.reprojection(decoded)
            sanity.check_reprojection(report.reprojection[where])
    except BackboneError as error:
        raise ManifestError(f"{where}: {error}") from None


def _measure(
    manifest: Manifest, precision: Precision, cases: list[Case], limits: Limits, report: Report
) -> None:
    if manifest.kind == "bundle":
        names = [f"{case.role}/{case.name}" for case in cases]
        report.measured += probe.golden_runs(manifest, precision, names, limits)
        report.max_views[precision] = manifest.frames.max
        return
    rows, ended = probe.ladder(manifest, precision, limits)
    report.measured += rows
    report.ended[precision] = ended
    report.max_views[precision] = rows[-1].views


def _choose(manifest: Manifest, report: Report) -> None:
    """Choose the fastest precision, at the largest number of views that all could run."""
    precisions = manifest.precisions()
    seconds = {p: _seconds(report.measured, p, precisions) for p in precisions}
    first = precisions[0]
    fastest = min(seconds, key=lambda p: seconds[p])
    report.precision = fastest if seconds[fastest] < WORTH_IT * seconds[first] else first
    each = ", ".join(f"{p} {s:.3g} s" for p, s in seconds.items())
    if len(precisions) == 1:
        report.why = f"{first} is the only precision ({each})"
    elif report.precision == first:
        report.why = f"{first}: no lower precision is 10 % faster ({each})"
    else:
        report.why = f"{report.precision}: fastest ({each})"


def _seconds(rows: list[Measured], precision: Precision, all_of: tuple[Precision, ...]) -> float:
    """Time of the largest run that every precision completed; for bundle, of all golden cases."""
    shared = set.intersection(*({(r.views, r.what) for r in rows if r.precision == p}
                                for p in all_of))  # fmt: skip
    largest = max(views for views, _ in shared)
    kept = [r for r in rows if r.precision == precision and (r.views, r.what) in shared]
    return sum(r.seconds for r in kept if r.views == largest)
