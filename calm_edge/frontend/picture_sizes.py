"""Notice when the pictures of a camera change their size within a drive."""

from __future__ import annotations

from device.frame import Eye, Frame


class PictureSizes:
    """The newest size of each camera's pictures.

    A camera that was reopened in another mode has another focal length in px, and perhaps another
    field of view: what was learned of its lens does not hold, and pictures of both sizes cannot be
    matched as neighbours.
    """

    def __init__(self) -> None:
        self._sizes: dict[Eye, tuple[int, int]] = {}

    def change(self, frame: Frame) -> str:
        """Note the size of a frame; return a line for the user if it has changed, else "".

        Raises UnreadableImage.
        """
        size, before = frame.size(), self._sizes.get(frame.eye)
        self._sizes[frame.eye] = size
        if before is None or before == size:
            return ""
        return (
            f"{frame.eye.name.lower()} camera: its pictures change from {before[0]}x{before[1]} to "
            f"{size[0]}x{size[1]} px at frame {frame.sequence}; tracking and the lens start anew"
        )
