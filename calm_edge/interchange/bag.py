"""Import of the camera topics of a bag: ROS 1, ROS 2, or MCAP with ROS or Foxglove messages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.bag_notes import FIX, IMU, INFO, BagNotes, calibration
from calm_edge.interchange.bag_pictures import encoded, stamp_ns
from calm_edge.interchange.bag_topics import Bag, choose
from calm_edge.interchange.base import Imported, ImportOptions
from calm_edge.interchange.mcap_bag import McapBag
from calm_edge.interchange.ros_bag import RosBag
from calm_edge.recording.sequence_folder import ORIGIN_NS
from calm_edge.types import Int
from device.frame import Eye, Frame


def open_bag(sources: tuple[Path, ...]) -> Bag:
    """Open a bag by its files; raises InterchangeError."""
    if sources[0].suffix == ".mcap" and sources[0].is_file():
        return McapBag(sources[0])
    return RosBag(sources)


class Bags:
    """Importer of two camera topics of one bag."""

    name = "bag"
    reads = "a ROS 1 bag, the folder of a ROS 2 bag, or an MCAP file"

    def recognises(self, sources: tuple[Path, ...]) -> bool:
        """Whether the sources are a bag by their names."""
        if len(sources) == 1 and sources[0].is_dir():
            found = sources[0]
            return (found / "metadata.yaml").is_file() and any(
                next(found.glob(pattern), None) for pattern in ("*.db3*", "*.mcap*")
            )
        if len(sources) == 1 and sources[0].suffix == ".mcap":
            return True
        return all(source.suffix in (".bag", ".db3") for source in sources)

    def open(
        self,
        sources: tuple[Path, ...],
        options: ImportOptions,
        scratch: Path,
        say: Callable[[str], None],
    ) -> Imported:
        """Choose the topics and read everything but the pictures; raises InterchangeError."""
        bag = open_bag(sources)
        topics = bag.topics()
        chosen, assumed = choose(sources[0], topics, options)
        notes, by_log_time, dropped = BagNotes(), set(), []
        names = (*(t.name for t in chosen), *(t.name for t in topics if t.kind in INFO + FIX + IMU))
        say(f"{sources[0]}: reading stamps of {sum(t.count for t in chosen)} pictures")
        kinds = {t.name: t.kind for t in topics}
        stamps: dict[str, list[int]] = {t.name: [] for t in chosen}
        for name, log_ns, message in bag.messages(names):
            if name in stamps:
                found = stamp_ns(kinds[name], message)
                stamps[name].append(found or log_ns)
                if not found:
                    by_log_time.add(name)
            else:
                notes.add(name, kinds[name], log_ns, message)
        eyes = tuple(Eye)[: len(chosen)]
        shift = _shift(options, assumed)
        kept = {
            eye: _increasing(np.array(stamps[topic.name], np.int64))
            for eye, topic in zip(eyes, chosen, strict=True)
        }
        for eye, topic in zip(eyes, chosen, strict=True):
            if not kept[eye].any():
                raise InterchangeError(f"{sources[0]}: {topic.name} holds no picture")
            if late := int((~kept[eye]).sum()):
                dropped.append(f"{topic.name}: {late} pictures not after the one before")
        if by_log_time:
            unstamped = ", ".join(sorted(by_log_time))
            assumed.append(f"{unstamped}: headers without a stamp; log times are taken")

        def frames(eye: Eye) -> Iterator[Frame]:
            topic, keep = chosen[eye], kept[eye]
            messages = open_bag(sources).messages((topic.name,))
            sequence = 0
            for number, (_, _log_ns, message) in enumerate(messages):
                if number < len(keep) and keep[number]:
                    t_ns = stamps[topic.name][number] + ORIGIN_NS + (shift if eye else 0)
                    data = encoded(topic.name, topic.kind, message, options.quality)
                    yield Frame(eye, sequence, t_ns, data)
                    sequence += 1

        published = calibration(notes, chosen, scratch, assumed)
        took = [
            f"{eye.name.lower()} {t.name}: {int(kept[eye].sum())} pictures, {t.kind}"
            for eye, t in zip(eyes, chosen, strict=True)
        ]
        samples = notes.samples(took, dropped)
        return Imported(
            eyes,
            frames,
            tuple(took),
            tuple(dropped),
            tuple(assumed),
            calibration=published,
            samples=samples,
        )


def _shift(options: ImportOptions, assumed: list[str]) -> int:
    if options.offset_s is None:
        assumed.append("both topics are stamped by one clock")
        return 0
    assumed.append(f"clock offset {options.offset_s:+g} s, as given")
    return round(1e9 * options.offset_s)


def _increasing(stamps: Int) -> Any:
    """Mask of stamps after all before."""
    before = np.r_[np.iinfo(np.int64).min, np.maximum.accumulate(stamps)[:-1]]
    return stamps > before if len(stamps) else np.zeros(0, bool)
