"""What the cameras settled on goes into the recording, what they do not do as asked to the user."""

from __future__ import annotations

import json
from collections.abc import Sequence

from calm_edge.daemon.switchboard import Switchboard
from calm_edge.recording.schema import CAMERAS_METADATA
from device.camera import Camera


class CameraNotes:
    """Owner of what was noted of the cameras so far, the primary first."""

    def __init__(self, desk: Switchboard, cameras: Sequence[Camera]) -> None:
        self._desk, self._cameras = desk, cameras
        self._noted: dict[str, str] = {}
        self._said: set[str] = set()

    def look(self) -> None:
        """Notes what is new since the last time: settings at once, and again when these change."""
        settings = {
            camera.spec.eye.name.lower(): json.dumps(dict(camera.settings), sort_keys=True)
            for camera in self._cameras
            if camera.settings
        }
        # a camera that is gone has no settings, and what it last had still tells of its pictures
        settings = self._noted | settings
        if settings != self._noted:
            self._noted = settings
            since = {"since_ns": str(self._desk.source.clock.now_ns())}
            self._desk.recording.write_metadata(CAMERAS_METADATA, settings | since)
        for camera in self._cameras:
            for remark in camera.remarks:
                if remark not in self._said:
                    self._said.add(remark)
                    self._desk.say(remark)
