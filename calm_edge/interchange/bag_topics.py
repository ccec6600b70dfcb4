"""Topics of a bag, and the choice of the two cameras'."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.bag_pictures import PICTURES
from calm_edge.interchange.base import ONE_CAMERA, ImportOptions
from calm_edge.interchange.video import natural

VIDEO = ("foxglove.CompressedVideo", "foxglove_msgs/msg/CompressedVideo")
# words in the names of what is the primary camera when there are two
PRIMARY_WORDS = ("primary", "left", "cam0", "cam_0", "camera0", "camera_0")


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag. kind: its message type, `package/msg/Type` or `foxglove.Type`."""

    name: str
    kind: str
    count: int


class Bag(Protocol):
    """An opened bag."""

    def topics(self) -> list[Topic]:
        """All topics with messages that can be decoded."""
        ...

    def messages(self, names: tuple[str, ...]) -> Iterator[tuple[str, int, Any]]:
        """Yield topic, log time [ns] and decoded message in order of log time."""
        ...


def choose(bag: Path, topics: list[Topic], options: ImportOptions) -> tuple[list[Topic], list[str]]:
    """Topics of the cameras, the primary's first, and what was assumed; raises InterchangeError."""
    pictures = _one_a_camera([t for t in topics if t.kind in PICTURES and t.count])
    listed = ", ".join(f"{t.name} ({t.kind}, {t.count})" for t in pictures) or "none"
    by_name = {t.name: t for t in topics if t.kind in PICTURES}
    if any(options.topics):
        for name in options.topics:
            if name and name not in by_name:
                raise InterchangeError(f"{bag}: no picture topic {name!r}; there are: {listed}")
        given = [by_name[name] for name in options.topics if name]
        if len(given) == 2 or options.single:
            return given, []
        raise InterchangeError(f"{bag}: give --primary and --assistant; there are: {listed}")
    if len(pictures) == 2:
        named = [t for t in pictures if any(word in t.name.lower() for word in PRIMARY_WORDS)]
        if len(named) == 1:
            pictures.sort(key=lambda t: t is not named[0])
        return pictures, [f"{pictures[0].name} is the primary, by the names"]
    if len(pictures) == 1 and options.single:
        return pictures, [ONE_CAMERA]
    if not pictures and any(t.kind in VIDEO for t in topics):
        raise InterchangeError(
            f"{bag}: its pictures are encoded as video (CompressedVideo), which is not read; "
            "record CompressedImage, or export each camera as mp4 and import these"
        )
    if len(pictures) < 2:
        raise InterchangeError(
            f"{bag}: two picture topics are needed, there are: {listed}"
            + ("; --single keeps the pictures of one" if pictures else "")
        )
    raise InterchangeError(
        f"{bag}: more than two picture topics; choose by --primary and --assistant: {listed}"
    )


def _one_a_camera(topics: list[Topic]) -> list[Topic]:
    """Drop the raw topic of a camera that also has a compressed one, and pictures of depth."""
    found = {t.name: t for t in topics if "depth" not in t.name.lower().rsplit("/", 1)[-1]}
    twice = {n for n in found if any(f"{n}/{word}" in found for word in ("compressed", "jpeg"))}
    return sorted((t for n, t in found.items() if n not in twice), key=lambda t: natural(t.name))
