"""The udev rules, as far as they can be tested without a device."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

RULES = Path(__file__).resolve().parents[2] / "deploy" / "99-calm-edge.rules"


def rules() -> list[str]:
    return [x for x in RULES.read_text().splitlines() if x and not x.startswith("#")]


def udev_can_verify() -> bool:
    """`udevadm verify` came with systemd 254."""
    if shutil.which("udevadm") is None:
        return False
    done = subprocess.run(["udevadm", "verify", "--help"], capture_output=True, check=False)
    return done.returncode == 0


@pytest.mark.skipif(not udev_can_verify(), reason="this udevadm has no `verify`")
def test_udev_accepts_them() -> None:
    command = ["udevadm", "verify", "--resolve-names=never", str(RULES)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_term_is_a_comparison_or_an_assignment() -> None:
    term = re.compile(r'[A-Z_]+(\{[^}]+\})?(==|!=|=|\+=)"[^"]*"')
    for rule in rules():
        for part in rule.split(", "):
            assert term.fullmatch(part), part


def test_no_device_is_open_to_everybody() -> None:
    modes = re.findall(r'MODE="(\d+)"', RULES.read_text())
    assert set(modes) == {"0660"}
    for rule in rules():
        assert ("MODE=" in rule) == ("GROUP=" in rule), rule


def test_the_groups_are_those_of_the_unit() -> None:
    unit = (RULES.parent / "calm-edge.service").read_text()
    groups = re.search(r"^SupplementaryGroups=(.*)$", unit, re.MULTILINE)
    assert groups is not None
    assert set(re.findall(r'GROUP="(\w+)"', RULES.read_text())) == set(groups[1].split())
