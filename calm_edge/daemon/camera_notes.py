"""Report changes of the camera settings, and the warnings of the cameras, once each."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence

from device.camera import Camera


class CameraNotes:
    """Reporter of camera settings when they change, and of each camera warning once.

    describe: called with changed settings: one JSON text each under `primary` and `assistant`, and
    the time of the change under `since_ns`. say: called with a warning for the user.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        describe: Callable[[Mapping[str, str]], None],
        say: Callable[[str], None],
    ) -> None:
        self._cameras, self._describe, self._say = cameras, describe, say
        self._settings: dict[str, str] = {}
        self._remarks: set[str] = set()

    def update(self, now_ns: int) -> None:
        """Report settings and warnings that are new since the last call."""
        settings = {
            camera.spec.eye.name.lower(): json.dumps(dict(camera.settings), sort_keys=True)
            for camera in self._cameras
            if camera.settings
        }
        # a disconnected camera reports no settings: keep the last ones, with which it recorded
        settings = self._settings | settings
        if settings != self._settings:
            self._settings = settings
            self._describe(settings | {"since_ns": str(now_ns)})
        for camera in self._cameras:
            for remark in camera.remarks:
                if remark not in self._remarks:
                    self._remarks.add(remark)
                    self._say(remark)
