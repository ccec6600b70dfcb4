"""What the live page is sent of a drive, and what it may ask for."""

from __future__ import annotations

import base64
import dataclasses
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calm_edge.config import Config, ConfigError, merge
from calm_edge.daemon.live_output import TEXT_LENGTH, LiveOutput
from calm_edge.daemon.messages import Attached, Event, Keep
from calm_edge.daemon.outputs import configured
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.state import Standing, State
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.live.board import Board
from calm_edge.live.source import Source
from calm_edge.live.wire import Message
from calm_edge.types import Landmarks, LocalizerUpdate, PoseStatus
from device.frame import Eye
from tests.daemon.test_health import HEALTH
from tests.recording import samples

NOW_NS = 77


class Page:
    """The output with a page that is connected to it."""

    def __init__(self, path: Path) -> None:
        config = merge(Config(), {"live": {"socket": str(path)}, "scale": {"spacing_m": 0.5}})
        self.output = LiveOutput(config, lambda: NOW_NS)
        self.board: Board[Message] = Board()
        self.source = Source(path, self.board)
        self.get("drive")
        self.until(lambda: self.output.readers == 1)

    def until(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + 20
        while not condition():
            assert time.monotonic() < end, "never happened"
            time.sleep(0.01)

    def get(self, kind: str, **required: Any) -> dict[str, Any]:
        """The newest message of a kind, once it has these entries."""

        def arrived() -> bool:
            message = self.board.get(kind)
            return message is not None and required.items() <= message.content.items()

        self.until(arrived)
        message = self.board.get(kind)
        assert message is not None
        return dict(message.content)


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Page]:
    monkeypatch.setattr("calm_edge.live.source.RETRY_S", 0.05)
    page = Page(tmp_path / "live.sock")
    yield page
    page.output.close(RecordResult())
    page.source.close()


def straight(points_w: np.ndarray) -> LocalizerUpdate:
    """A sub-map at the origin, its assistant half a metre to the right; it sees points_w (N, 3)."""
    base = samples.update()
    camera = Perspective(500, 500, 319.5, 239.5, 640, 480)
    cameras, T_p_a = (camera,) * 5, se3.compose(np.eye(3), np.array([0.5, 0, 0]))
    T = np.stack([np.eye(4)] * 3 + [T_p_a] * 2)
    view = np.full(len(points_w), 4)
    p_a = points_w - [0.5, 0, 0]
    marks = Landmarks(
        points_w, np.arange(len(points_w)), view, camera.project(p_a).astype(np.float32)
    )
    submap = dataclasses.replace(
        base.submap, T_s_c_raw=T, T_s_c=T, cameras=cameras, cameras_raw=cameras, scale=1.0,
        T_w_s=np.eye(4),
    )  # fmt: skip
    prediction = dataclasses.replace(base.prediction, cameras=cameras, T_s_c=T, landmarks=marks)
    trajectory = dataclasses.replace(base.trajectory, T_p_a=T_p_a)
    return dataclasses.replace(base, submap=submap, prediction=prediction, trajectory=trajectory)


def test_it_is_an_output_only_if_a_socket_is_configured(tmp_path: Path) -> None:
    assert configured(Config(), time.monotonic_ns) == []
    config = merge(Config(), {"live": {"socket": str(tmp_path / "s")}})
    (output,) = configured(config, time.monotonic_ns)
    assert isinstance(output, LiveOutput) and not output.immediate
    output.close(RecordResult())
    too_long = merge(Config(), {"live": {"socket": "/" + "x" * 120}})
    with pytest.raises(ConfigError, match=r"live\.socket"):
        configured(too_long, time.monotonic_ns)


def test_only_a_page_wants_frames(page: Page) -> None:
    assert page.output.wants_frames
    page.output._moves_s = time.monotonic()
    page.output.frame(samples.frame(Eye.PRIMARY, 0))
    page.source.close()
    page.until(lambda: not page.output.wants_frames)
    page.output.status(Standing(State.RUNNING), HEALTH)
    assert not page.output._frames


def test_the_trackers_points_come_with_the_frame_they_are_in(page: Page) -> None:
    frames = [samples.frame(Eye.PRIMARY, k) for k in range(5)]
    page.output._moves_s = time.monotonic()
    for frame in frames:
        page.output.frame(frame)
    moves = np.array([[10.04, 20, 8, 19]], np.float32)
    page.output.moves(frames[3].t_ns, moves)
    assert page.get("primary", t_ns=frames[3].t_ns)["moves"] == [[10.0, 20, 8, 19]]
    message = page.board.get("primary")
    assert message is not None and message.data == frames[3].image
    # of a frame that is gone
    page.output.moves(12345, moves)
    assert page.get("primary")["t_ns"] == frames[3].t_ns


def test_without_a_pose_pictures_come_without_points(page: Page) -> None:
    frame = samples.frame(Eye.PRIMARY, 0)
    page.output.frame(frame)
    assert "moves" not in page.get("primary", t_ns=frame.t_ns)
    # twice a second, not every frame
    page.output.frame(samples.frame(Eye.PRIMARY, 1))
    time.sleep(0.05)
    assert page.get("primary")["t_ns"] == frame.t_ns


def test_points_are_drawn_where_pose_rig_and_lens_expect_them_in_the_assistant(page: Page) -> None:
    points_w = np.array([[0.5, 0, 10.0], [2.5, 1, 10.0], [0, 0, -5.0], [90, 0, 10.0]])
    page.output.update(straight(points_w[:2]))
    page.output._points_w = points_w
    frame = samples.frame(Eye.ASSISTANT, 0)
    # the car has moved 1 m forward since the map, and moves on at 10 m/s; 0.1 s until the exposure
    T_o_c = se3.compose(np.eye(3), np.array([0, 0, 1.0]))
    sample = dataclasses.replace(
        samples.pose(), t_ns=frame.t_ns - 100_000_000, T_w_c=T_o_c, status=PoseStatus.LIVE,
        velocity_c=np.array([0, 0, 10.0]), turn_rate_c=np.zeros(3),
    )  # fmt: skip
    T_map_odom = se3.compose(np.eye(3), np.array([0, 0, 3.0]))
    page.output.attached(Attached(0, True, T_map_odom))
    page.output.pose(sample, NOW_NS)
    page.output.frame(frame)
    # 3 m + 1 m + 1 m of the 10 m are behind it
    expected = [[319.5, 239.5], [319.5 + 500 * 2 / 5, 239.5 + 500 * 1 / 5]]
    np.testing.assert_allclose(page.get("assistant", t_ns=frame.t_ns)["points"], expected, atol=0.1)
    assert page.get("pose")["y"] == 4.0


def test_a_lost_pose_has_no_place(page: Page) -> None:
    lost = dataclasses.replace(samples.pose(), status=PoseStatus.LOST)
    page.output.pose(lost, NOW_NS)
    assert page.get("pose") == {"status": "lost"}
    page.output.update(straight(np.array([[0, 0, 10.0]])))
    page.output.frame(samples.frame(Eye.ASSISTANT, 0))
    assert "points" not in page.get("assistant")


def test_a_sub_map_brings_path_kit_and_mask(page: Page) -> None:
    page.output.update(straight(np.array([[0, 0, 10.0]])))
    assert len(page.get("plan")["path"]) == 9
    assert page.get("kit")["primary"]["focal_px"] == 500
    mask = page.get("masks")
    assert mask["primary"] is None
    bits = np.frombuffer(base64.b64decode(mask["assistant"]["bits"]), np.uint8)
    found = np.unpackbits(bits.reshape(2, -1), axis=1)[:, :3]
    np.testing.assert_array_equal(found, np.arange(6).reshape(2, 3) % 2)


def test_the_state_is_kept_while_the_last_windows_are_solved(page: Page) -> None:
    page.output.status(Standing(State.RUNNING), HEALTH)
    health = page.get("health", state="RUNNING")
    assert health["counts"]["submaps"] == HEALTH.counts["submaps"] and "left" in health
    page.output.status(Standing(State.STOPPING), None)
    stopping = page.get("health", state="STOPPING")
    assert stopping["counts"] == health["counts"]


def test_the_page_may_mark_events_and_protect_the_drive(page: Page) -> None:
    assert page.source.ask("event", {"text": " tram \n crosses " + "x" * 900})
    assert page.source.ask("keep", {"kept": True})
    assert page.source.ask("other", {})
    found: list[Event | Keep] = []

    def arrived() -> bool:
        found.extend(page.output.requests())
        return len(found) >= 2

    page.until(arrived)
    assert isinstance(found[0], Event) and found[0].t_ns == NOW_NS
    assert found[0].text.startswith("tram crosses x") and len(found[0].text) == TEXT_LENGTH
    assert found[1:] == [Keep(True)]
    page.output.event(found[0])
    assert page.get("events")["events"][0]["text"] == found[0].text


def test_a_flood_of_requests_is_bounded(page: Page) -> None:
    for _ in range(500):
        page.source.ask("event", {})
    time.sleep(0.2)
    assert len(page.output.requests()) <= 50


def test_warnings_and_the_end_are_told(page: Page) -> None:
    page.output.say(30, "window 3: too dark", "daemon")
    page.output.say(20, "RUNNING: all is well", "state")
    assert page.get("notes")["notes"] == ["window 3: too dark"]
    page.output.close(RecordResult(frames=[3, 0]))
    assert "no frame of the assistant camera" in page.get("end")["losses"]


def test_a_page_that_reads_nothing_holds_up_nothing(tmp_path: Path) -> None:
    config = merge(Config(), {"live": {"socket": str(tmp_path / "s")}})
    output = LiveOutput(config, lambda: NOW_NS)
    with socket.socket(socket.AF_UNIX) as silent:
        end = time.monotonic() + 10
        while silent.connect_ex(str(tmp_path / "s")):
            assert time.monotonic() < end
            time.sleep(0.01)
        while not output.readers:
            time.sleep(0.01)
        frame = dataclasses.replace(samples.frame(Eye.PRIMARY, 0), image=bytes(400_000))
        longest_s = 0.0
        for _ in range(60):
            started_s = time.monotonic()
            output._shown_s[Eye.PRIMARY] = 0.0
            output.frame(frame)
            longest_s = max(longest_s, time.monotonic() - started_s)
        assert longest_s < 0.5
    output.close(RecordResult())
