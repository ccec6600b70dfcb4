"""A package from a staged tree: reproducible, owned by root, with its settings as conffiles."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from deploy.deb_archive import SCRIPTS, control_folder, pack

pytestmark = pytest.mark.skipif(shutil.which("dpkg-deb") is None, reason="no dpkg-deb")
DEBIAN = Path(__file__).resolve().parents[2] / "deploy" / "debian"
FIELDS = {
    "Package": "calm-edge",
    "Version": "1.2",
    "Architecture": "amd64",
    "Maintainer": "nobody <nobody@calm-edge.invalid>",
    "Description": "a test",
}


def staged(folder: Path, mtime_s: int, mode: int) -> Path:
    for name, text in {"etc/calm-edge/a.toml": "x = 1\n", "opt/calm-edge/bin/run": "#!\n"}.items():
        path = folder / name
        path.parent.mkdir(parents=True)
        path.write_text(text)
        path.chmod(mode)
        os.utime(path, (mtime_s, mtime_s))
    for script in SCRIPTS:
        shutil.copy(DEBIAN / script, control_folder(folder) / script)
    return folder


def dpkg_deb(deb: Path, *words: str) -> str:
    return subprocess.run(
        ["dpkg-deb", *words, deb], check=True, capture_output=True, text=True
    ).stdout


def test_the_same_files_give_the_same_bytes_whoever_staged_them_when(tmp_path: Path) -> None:
    debs = []
    for k, (mtime_s, mode) in enumerate([(2_000_000_000, 0o600), (2_100_000_000, 0o666)]):
        out = tmp_path / str(k)
        out.mkdir()
        debs.append(
            pack(staged(tmp_path / f"tree{k}", mtime_s, mode), out, FIELDS, "1700000000")[0]
        )
    assert debs[0].read_bytes() == debs[1].read_bytes()
    listing = dpkg_deb(debs[0], "--contents").splitlines()
    modes = {line.split()[-1]: line.split()[:2] for line in listing}
    assert modes["./etc/calm-edge/a.toml"] == ["-rw-r--r--", "root/root"]
    assert modes["./opt/calm-edge/bin/run"] == ["-rwxr-xr-x", "root/root"]


def test_settings_are_conffiles_and_the_rest_is_summed(tmp_path: Path) -> None:
    deb, line = pack(
        staged(tmp_path / "tree", 2_000_000_000, 0o644), tmp_path, FIELDS, "1700000000"
    )
    control = tmp_path / "control"
    dpkg_deb(deb, "--info")
    subprocess.run(["dpkg-deb", "--control", deb, control], check=True)
    assert (control / "conffiles").read_text() == "/etc/calm-edge/a.toml\n"
    assert (control / "md5sums").read_text().split()[1::2] == ["opt/calm-edge/bin/run"]
    assert "Installed-Size: " in (control / "control").read_text()
    assert str(deb) in line


@pytest.mark.parametrize("script", SCRIPTS)
def test_maintainer_scripts_parse_and_stop_at_the_first_error(script: str) -> None:
    path = DEBIAN / script
    assert subprocess.run(["sh", "-n", path], check=False).returncode == 0
    assert "\nset -e\n" in path.read_text()


def test_no_maintainer_script_deletes_what_was_recorded() -> None:
    for script in SCRIPTS:
        for line in (DEBIAN / script).read_text().splitlines():
            assert not ("rm -r" in line and "/var/lib" in line), line
