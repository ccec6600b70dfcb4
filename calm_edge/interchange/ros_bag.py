"""Read ROS 1 bags, and ROS 2 bags of either storage, by the package rosbags."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.bag_topics import Topic

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader


def require_rosbags() -> Any:
    """Import rosbags; raises InterchangeError with the remedy if it is missing."""
    try:
        import rosbags.highlevel
        import rosbags.typesys
    except ImportError:
        raise InterchangeError(
            "rosbags: not installed; bags need it (pip install 'calm-edge[import]')"
        ) from None
    return rosbags


class RosBag:
    """A ROS 1 bag, its parts in several files, or the folder of a ROS 2 bag."""

    def __init__(self, sources: tuple[Path, ...]) -> None:
        require_rosbags()
        self._sources = sources
        if sources[0].suffix == ".db3":
            raise InterchangeError(
                f"{sources[0]}: give the folder that holds it and metadata.yaml, which names its "
                "topics (ros2 bag reindex writes one)"
            )

    def topics(self) -> list[Topic]:
        """All topics."""
        with self._opened() as reader:
            return [
                Topic(name, info.msgtype, info.msgcount)
                for name, info in sorted(reader.topics.items())
                if info.msgtype is not None
            ]

    def messages(self, names: tuple[str, ...]) -> Iterator[tuple[str, int, Any]]:
        """Yield topic, log time [ns] and decoded message in order of log time."""
        from rosbags.highlevel import AnyReaderError

        with self._opened() as reader:
            wanted = [c for c in reader.connections if c.topic in names]
            if not wanted:
                return
            try:
                for connection, log_ns, raw in reader.messages(wanted):
                    message = reader.deserialize(raw, connection.msgtype)
                    yield connection.topic, log_ns, message
            except (AnyReaderError, OSError) as error:
                raise InterchangeError(f"{self._sources[0]}: damaged ({error})") from None

    @contextmanager
    def _opened(self) -> Iterator[AnyReader]:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.LATEST)
        with ExitStack() as stack:
            try:
                reader = AnyReader(list(self._sources), default_typestore=store)
                stack.enter_context(reader)
            except (AnyReaderError, OSError) as error:
                raise InterchangeError(
                    f"{self._sources[0]}: cannot be read as a ROS bag ({error}); repair it "
                    "(rosbag reindex, ros2 bag reindex)"
                ) from None
            yield reader
