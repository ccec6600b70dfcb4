"""Packages of another architecture: which wheels are taken, and why a test of them is skipped."""

from __future__ import annotations

import dataclasses
import os
import shutil
from pathlib import Path

import pytest

from deploy import build_deb, try_foreign_deb
from deploy.build_deb import Target, target_of
from deploy.try_foreign_deb import EMULATED, emulation, missing

ARM = Target(Path("/usr/bin/python3.11"), (3, 11), "arm64", "2.36", foreign=True)


def test_wheels_of_the_architecture_up_to_the_release_s_c_library_are_taken() -> None:
    options = ARM.wheels
    assert options[:5] == [
        "--implementation", "cp", "--python-version", "311", "--only-binary=:all:",
    ]  # fmt: skip
    platforms = [o.removeprefix("--platform=") for o in options[5:]]
    assert platforms[0] == "manylinux_2_36_aarch64" and "manylinux_2_17_aarch64" in platforms
    assert "manylinux2014_aarch64" in platforms
    assert not any("x86_64" in p or "2_37" in p for p in platforms)


def test_for_this_machine_pip_chooses() -> None:
    assert dataclasses.replace(ARM, foreign=False).wheels == []


def test_an_unknown_architecture_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        build_deb, "output", lambda *command: "3 11 2.36" if "-c" in command else "amd64"
    )
    with pytest.raises(SystemExit, match=r"ARCH=riscv64: choose one of amd64, arm64"):
        target_of(Path("/bin/sh"), "riscv64")
    assert target_of(Path("/bin/sh"), "arm64").foreign
    assert not target_of(Path("/bin/sh"), "amd64").foreign
    assert target_of(Path("/bin/sh")).architecture == "amd64"


def test_without_the_emulator_the_reason_names_the_packages(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None if "qemu" in name else f"/bin/{name}")
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    assert missing("arm64") == (
        "qemu-aarch64-static not installed: apt-get install qemu-user-static debootstrap"
    )
    monkeypatch.setattr(shutil, "which", lambda name: f"/bin/{name}")
    assert missing("arm64") == "" and "choose one of arm64" in missing("s390x")
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    assert missing("arm64") == "not root"


def test_a_kernel_without_binfmt_misc_is_a_reason_to_skip(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(try_foreign_deb, "BINFMT", tmp_path / "none")
    monkeypatch.setattr("subprocess.run", lambda *a, **k: None)
    with emulation("arm64") as works:
        assert not works


def test_an_emulator_that_is_registered_already_stays(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(try_foreign_deb, "BINFMT", tmp_path)
    (tmp_path / "register").touch()
    (tmp_path / "qemu-aarch64").write_text("enabled")
    with emulation("arm64") as works:
        assert works
    assert (tmp_path / "qemu-aarch64").read_text() == "enabled"
    assert (tmp_path / "register").read_text() == ""


def test_the_rule_covers_the_header_of_a_program() -> None:
    for _, magic, mask in EMULATED.values():
        assert magic.count("\\x") + 3 == mask.count("\\x") == 20
