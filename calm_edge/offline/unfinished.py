"""What an interrupted `map` has computed, kept in its output folder for `--resume`.

In the folder `unfinished`: `plan.json` says of what, `solved-N` are recordings with the windows
that the Nth run has solved, `placed` is one with all sub-maps in their final placement, and `spool`
holds the depth of those.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import calm_edge
from calm_edge.config import Config
from calm_edge.offline.drive import Drive
from calm_edge.recording import RecordingError
from calm_edge.recording.reader import Recording
from calm_edge.recording.schema import STATUS
from calm_edge.recording.segment import recording_files
from calm_edge.recording.window_record import WindowRecord
from calm_edge.recording.writer import RecordingWriter
from calm_edge.types import CalmEdgeError, LocalizerUpdate
from device.atomic_file import replace_text

FOLDER = "unfinished"


class UnfinishedError(CalmEdgeError):
    """An unfinished map is of something else, or cannot be read or written."""


def plan(recording: Path, config: Config, *, again: bool = False) -> dict[str, Any]:
    """What a map is made of: the recording's files, the configuration and the version.

    again: all windows are solved again, also those that `record` solved.
    """
    stats = [(file, file.stat()) for file in recording_files(recording)]
    return {
        "version": calm_edge.__version__,
        "files": [[str(f.resolve()), s.st_size, s.st_mtime_ns] for f, s in stats],
        "config": config.to_dict(),
        "solved_again": again,
    }


class Unfinished:
    """The computed parts of a map; a context manager that closes its files.

    folder: in the output folder. made_of: the `plan`. Opening continues what is in the folder.
    Raises UnfinishedError if that was made of something else.
    """

    def __init__(self, folder: Path, config: Config, made_of: Mapping[str, Any]) -> None:
        self._folder, self._config = folder, config
        self._writer: RecordingWriter | None = None
        text = json.dumps(made_of, indent=1, sort_keys=True)
        file = folder / "plan.json"
        if not folder.exists():
            try:
                folder.mkdir(parents=True)
                replace_text(file, text)
            except OSError as error:
                raise UnfinishedError(
                    f"{folder}: cannot be written ({error.strerror}); choose another output folder"
                ) from None
            return
        try:
            same = file.read_text() == text
        except (OSError, UnicodeDecodeError):
            same = False
        if not same:
            raise UnfinishedError(
                f"{folder}: was made of another recording, with other settings or by another "
                "version; start anew with --force"
            )

    def __enter__(self) -> Unfinished:
        return self

    def __exit__(self, *exception: object) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    @property
    def spool(self) -> Path:
        """Folder for depth and anchors of the sub-maps."""
        return self._folder / "spool"

    def solved(self) -> dict[int, tuple[WindowRecord, LocalizerUpdate]]:
        """Windows that earlier runs have solved, by sub-map id, in order of ids."""
        found: dict[int, tuple[WindowRecord, LocalizerUpdate]] = {}
        for folder in self._runs():
            recording = Recording(folder)
            windows = {record.submap_id: record for record in recording.windows()}
            for update in recording.updates():
                if update.submap.id in windows:
                    found[update.submap.id] = windows[update.submap.id], update
        return dict(sorted(found.items()))

    def add(self, record: WindowRecord, update: LocalizerUpdate) -> None:
        """Keep a window that was solved now."""
        if self._writer is None:
            folder = self._folder / f"solved-{len(self._runs())}"
            self._writer = RecordingWriter(folder, self._config, lossless=True)
        self._writer.write_window(record)
        self._writer.write_update(update)

    def placed(self) -> Drive | None:
        """The drive with all sub-maps placed, if an earlier run came so far."""
        try:
            recording = Recording(self._folder / "placed")
        except RecordingError:
            return None
        ends = list(recording.json_messages(STATUS))
        if not ends:
            return None
        drive = Drive(list(recording.windows()), list(recording.updates()))
        drive.unsolved, drive.losses = ends[-1]["unsolved"], ends[-1]["losses"]
        drive.trajectory = drive.updates[-1].trajectory
        drive.metre = drive.updates[-1].metre
        return drive

    def place(self, drive: Drive) -> None:
        """Keep the placed sub-maps; the depth in the spool belongs to them."""
        assert drive.trajectory is not None
        shutil.rmtree(self._folder / "placed", ignore_errors=True)
        with RecordingWriter(self._folder / "placed", self._config, lossless=True) as writer:
            *others, last = drive.updates
            last = replace(last, trajectory=drive.trajectory, metre=drive.metre)
            for record, update in zip(drive.windows, (*others, last), strict=True):
                writer.write_window(record)
                writer.write_update(update)
            writer.write_status({"unsolved": drive.unsolved, "losses": drive.losses})

    def remove(self) -> None:
        """Remove all of it: the map is complete."""
        self.__exit__()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _runs(self) -> list[Path]:
        """Folders of the windows solved by earlier runs, in order."""
        found = [f for f in self._folder.glob("solved-*") if f.name[7:].isdigit()]
        return sorted(found, key=lambda f: int(f.name[7:]))
