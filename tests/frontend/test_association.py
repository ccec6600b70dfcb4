"""Windows: association, overlap and completeness."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calm_edge.config import FrontendConfig
from calm_edge.frontend.association import WindowBuilder, WindowError, is_thin
from calm_edge.types import Keyframe, SubmapWindow
from device.frame import Eye, Frame

MS = 1_000_000


def primary(i: int, t_ms: float) -> Keyframe:
    return Keyframe(i, Frame(Eye.PRIMARY, i, int(t_ms * MS), b"p"))


def assistant(i: int, t_ms: float) -> Frame:
    return Frame(Eye.ASSISTANT, i, int(t_ms * MS), b"a")


def run(
    n: int, offset_ms: float = 0.0, period_ms: float = 100.0, **config: int
) -> list[SubmapWindow]:
    """n keyframes 100 ms apart, assistant frames every period_ms, merged by time, then flush."""
    builder = WindowBuilder(FrontendConfig(**config))  # type: ignore[arg-type]
    count = int(n * 100 / period_ms)
    events = [(100.0 * i, 0, i) for i in range(n)]
    events += [(period_ms * i + offset_ms, 1, i) for i in range(count)]
    windows: list[SubmapWindow] = []
    for t_ms, eye, i in sorted(events):
        if eye:
            windows += builder.add_assistant(assistant(i, t_ms))
        else:
            windows += builder.advance(int(t_ms * MS))
            windows += builder.add_keyframe(primary(i, t_ms))
    return windows + list(builder.flush())


def test_windows_overlap_and_contain_every_keyframe_once_as_new() -> None:
    windows = run(50)
    assert [w.submap_id for w in windows] == list(range(len(windows)))
    new = [k.id for w in windows for k in w.primary[w.n_overlap :]]
    assert new == list(range(50))
    for before, after in itertools.pairwise(windows):
        overlap = after.primary[: after.n_overlap]
        assert before.primary[-after.n_overlap :] == overlap
    assert [len(w.primary) for w in windows[:-1]] == [6] + [15] * (len(windows) - 2)
    assert [w.n_overlap for w in windows[:-1]] == [0, 6, 3, 3]


def test_the_short_first_window_does_not_change_later_ones() -> None:
    early, without = run(50), run(50, first_window=15)
    assert [w.primary for w in early[1:]] == [w.primary for w in without]
    assert [w.assistant for w in early[1:]] == [w.assistant for w in without]
    assert early[0].primary == without[0].primary[:6] and early[1].n_overlap == 6


def test_a_builder_continues_the_numbers_of_another() -> None:
    builder = WindowBuilder(FrontendConfig(n_max=4, n_overlap=1, first_window=3), 7, 30)
    windows: list[SubmapWindow] = []
    for i in range(6):
        windows += builder.add_assistant(assistant(i, 100.0 * i))
        windows += builder.add_keyframe(primary(20 + i, 100.0 * i))
    assert [(w.submap_id, w.n_overlap, len(w.primary)) for w in windows] == [(7, 0, 3), (8, 3, 4)]
    assert [a.id for a in windows[1].assistant] == [30, 31, 32, 33]


@settings(max_examples=40, deadline=None)
@given(st.integers(2, 70), st.floats(-49, 49), st.sampled_from([50.0, 100.0, 160.0, 333.0]))
def test_every_association_is_the_closest_frame(n: int, offset: float, period: float) -> None:
    frames = [int((period * i + offset) * MS) for i in range(int(n * 100 / period))]
    for window in run(n, offset, period):
        wanted = sorted(
            {
                min(frames, key=lambda t: (abs(t - k.frame.t_ns), t))
                for k in window.primary
                if frames and min(abs(t - k.frame.t_ns) for t in frames) <= 500 * MS
            }
        )
        assert [a.frame.t_ns for a in window.assistant] == wanted


def test_synchronous_streams_pair_exactly_in_any_order_of_arrival() -> None:
    builder = WindowBuilder(FrontendConfig(n_max=4, n_overlap=1))
    windows: list[SubmapWindow] = []
    for i in range(4):
        windows += builder.add_assistant(assistant(i, 100.0 * i))
        windows += builder.add_keyframe(primary(i, 100.0 * i))
    assert windows == [w for w in run(4, n_max=4, n_overlap=1) if w.submap_id == 0]
    assert [a.frame.t_ns for a in windows[0].assistant] == [0, 100 * MS, 200 * MS, 300 * MS]


def test_a_slow_assistant_is_deduplicated_and_keeps_its_ids_in_the_overlap() -> None:
    windows = run(40, period_ms=250.0)
    assert len(windows[0].assistant) < 15
    ids = {a.frame.t_ns: a.id for w in windows for a in w.assistant}
    assert sorted(ids.values()) == list(range(len(ids)))
    shared = {a.id for a in windows[0].assistant} & {a.id for a in windows[1].assistant}
    assert shared


def test_a_keyframe_waits_for_the_later_assistant_frame() -> None:
    builder = WindowBuilder(FrontendConfig(n_max=2, n_overlap=1))
    builder.add_assistant(assistant(0, -40))
    builder.add_keyframe(primary(0, 0))
    assert builder.add_keyframe(primary(1, 100)) == ()
    assert builder.add_assistant(assistant(1, 30)) == ()
    (window,) = builder.add_assistant(assistant(2, 130))
    assert [a.frame.t_ns for a in window.assistant] == [30 * MS, 130 * MS]


def test_without_an_assistant_windows_are_built_and_thin() -> None:
    builder = WindowBuilder(FrontendConfig(n_max=4, n_overlap=1))
    windows: list[SubmapWindow] = []
    for i in range(30):
        windows += builder.advance(i * 100 * MS)
        windows += builder.add_keyframe(primary(i, i * 100.0))
    assert windows and all(is_thin(w) and w.assistant == () for w in windows)


def test_a_single_keyframe_makes_no_window_and_two_do() -> None:
    assert run(1) == []
    (window,) = run(2)
    assert len(window.primary) == 2 and window.n_overlap == 0


def test_a_short_last_window_overlaps_by_more() -> None:
    tail = run(16)[-1]
    assert len(tail.primary) == 8 and tail.n_overlap == 7


def test_an_impossible_overlap_raises() -> None:
    with pytest.raises(WindowError, match="n_overlap = 15"):
        WindowBuilder(FrontendConfig(n_overlap=15))


def late_pairs(late_ms: float, known_after: int) -> list[tuple[int, float]]:
    """Frame numbers of assistant minus primary, in order, with stamps `late_ms` after exposure.

    The builder learns of it at keyframe `known_after`.
    """
    builder = WindowBuilder(FrontendConfig())
    events = [(100.0 * i, 0, i) for i in range(60)]
    events += [(100.0 * i + late_ms, 1, i) for i in range(60)]
    windows: list[SubmapWindow] = []
    for t_ms, eye, i in sorted(events):
        if eye:
            windows += builder.add_assistant(assistant(i, t_ms))
            continue
        if i == known_after:
            builder.late_ns = int(-late_ms * MS)
        windows += builder.advance(int(t_ms * MS))
        windows += builder.add_keyframe(primary(i, t_ms))
    windows += builder.flush()
    for window in windows:
        stamps = [k.frame.t_ns for k in window.assistant]
        assert stamps == sorted(set(stamps))
        assert len({k.id for k in window.assistant}) == len(stamps)
    last = windows[-2]
    return [
        (p.frame.sequence, a.frame.sequence)
        for p, a in zip(last.primary[3:-5], last.assistant[3:], strict=False)
    ]


@pytest.mark.parametrize("late_ms", [-300.0, -100.0, 200.0, 400.0])
@pytest.mark.parametrize("known_after", [0, 20])
def test_frames_exposed_together_are_associated_once_the_stamps_are_known_to_be_late(
    late_ms: float, known_after: int
) -> None:
    pairs = late_pairs(late_ms, known_after)
    assert len(pairs) >= 5
    assert all(p == a for p, a in pairs)


def test_after_a_cut_windows_share_nothing_with_those_before() -> None:
    builder = WindowBuilder(FrontendConfig())
    windows: list[SubmapWindow] = []
    for i in range(40):
        if i == 20:
            windows += builder.cut()
            n_before = len(windows)
            assert not list(builder.held())
        windows += builder.add_assistant(assistant(i, 100.0 * i + 1))
        windows += builder.advance(int(100.0 * i * MS))
        windows += builder.add_keyframe(primary(i, 100.0 * i))
    windows += builder.flush()
    before, after = windows[:n_before], windows[n_before:]
    assert [w.submap_id for w in windows] == list(range(len(windows)))
    assert {k.id for w in before for k in w.primary} == set(range(20))
    assert {k.id for w in after for k in w.primary} == set(range(20, 40))
    assert after[0].n_overlap == 0 and len(after[0].primary) == FrontendConfig().first_window
    ids = [{k.id for w in part for k in w.assistant} for part in (before, after)]
    assert not ids[0] & ids[1]
