import os
import stat

import pytest

from device.atomic_file import replace_text


def test_a_replaced_file_keeps_its_mode_and_leaves_nothing_beside_it(tmp_path):
    path = tmp_path / "kit.toml"
    replace_text(path, "old\n")
    path.chmod(0o640)
    replace_text(path, "new é\n")
    assert path.read_text(encoding="utf-8") == "new é\n"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("fault", ["fsync", "replace"])
def test_a_failed_write_leaves_the_earlier_file(tmp_path, monkeypatch, fault):
    path = tmp_path / "kit.toml"
    replace_text(path, "old\n")

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, fault, fail)
    with pytest.raises(OSError, match="No space left"):
        replace_text(path, "new\n")
    assert path.read_text() == "old\n" and list(tmp_path.iterdir()) == [path]


def test_the_file_and_then_its_folder_are_flushed(tmp_path, monkeypatch):
    flushed = []
    monkeypatch.setattr(os, "fsync", lambda fd: flushed.append(os.fstat(fd).st_ino))
    replace_text(tmp_path / "kit.toml", "new\n")
    assert flushed == [p.stat().st_ino for p in (tmp_path / "kit.toml", tmp_path)]
