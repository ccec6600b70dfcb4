"""Settings and remarks of the cameras are passed on once."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

from calm_edge.daemon.camera_notes import CameraNotes
from device.frame import Eye

AUTO = '{"gain": "auto"}'


class Scene:
    """Notes of two cameras."""

    def __init__(self) -> None:
        self.cameras: list[Any] = [
            SimpleNamespace(spec=SimpleNamespace(eye=eye), settings={"gain": "auto"}, remarks=())
            for eye in Eye
        ]
        self.described: list[Mapping[str, str]] = []
        self.remarks: list[str] = []
        self.notes = CameraNotes(self.cameras, self.described.append, self.remarks.append)


def test_settings_are_passed_on_at_start_and_on_change() -> None:
    scene = Scene()
    scene.notes.update(5)
    scene.notes.update(6)
    assert scene.described == [{"primary": AUTO, "assistant": AUTO, "since_ns": "5"}]
    scene.cameras[0].settings = {"gain": 7}
    # a disconnected camera has no settings
    scene.cameras[1].settings = {}
    scene.notes.update(7)
    assert scene.described[1:] == [{"primary": '{"gain": 7}', "assistant": AUTO, "since_ns": "7"}]


def test_a_remark_is_passed_on_once() -> None:
    scene = Scene()
    scene.cameras[1].remarks = ("assistant camera y: has no gain control; not set",)
    scene.notes.update(5)
    scene.notes.update(6)
    assert scene.remarks == ["assistant camera y: has no gain control; not set"]
