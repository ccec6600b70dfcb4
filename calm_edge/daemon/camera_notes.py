"""Camera settings for the recording; remarks of the cameras for the user."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence

from device.camera import Camera


class CameraNotes:
    """Owner of the settings and remarks passed on so far.

    describe: takes the settings of both cameras, as JSON by eye, and since_ns. say: takes a remark.
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
        """Pass on what is new since the last call."""
        settings = {
            camera.spec.eye.name.lower(): json.dumps(dict(camera.settings), sort_keys=True)
            for camera in self._cameras
            if camera.settings
        }
        # a camera that is gone has no settings; its last ones still hold for its pictures
        settings = self._settings | settings
        if settings != self._settings:
            self._settings = settings
            self._describe(settings | {"since_ns": str(now_ns)})
        for camera in self._cameras:
            for remark in camera.remarks:
                if remark not in self._remarks:
                    self._remarks.add(remark)
                    self._say(remark)
