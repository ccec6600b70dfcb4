"""The units: accepted by systemd, sandboxed, with the limits that the daemon needs."""

from __future__ import annotations

import argparse
import shutil
import subprocess
from collections import defaultdict
from ipaddress import ip_network
from pathlib import Path

import pytest

from calm_edge.cli import build_parser
from calm_edge.commands.exit_codes import LOSS
from calm_edge.config import CaptureConfig, load
from calm_edge.daemon import finish

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
UNIT, LIVE = DEPLOY / "calm-edge.service", DEPLOY / "calm-edge-live.service"
OPEN = DEPLOY / "calm-edge-live-open.conf"
EXPOSURE = 3.0

needs_systemd = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed"
)


def settings(unit: Path = UNIT) -> dict[str, list[str]]:
    """Every value of each key, in order."""
    found: dict[str, list[str]] = defaultdict(list)
    for line in unit.read_text().splitlines():
        key, equals, value = line.partition("=")
        if equals and not line.startswith("#"):
            found[key].append(value)
    return found


def seconds(key: str) -> float:
    return float(settings()[key][0])


def with_program(unit: Path, folder: Path) -> Path:
    """A unit in a folder, with a program that is there without the package."""
    copied = folder / unit.name
    copied.write_text(unit.read_text().replace("/opt/calm-edge/bin/calm-edge", "/bin/true"))
    return copied


@needs_systemd
@pytest.mark.parametrize("opened", [False, True])
@pytest.mark.parametrize("file", [UNIT, LIVE])
def test_systemd_analyze_verify_is_silent(tmp_path: Path, file: Path, opened: bool) -> None:
    unit = with_program(file, tmp_path)
    if opened and file == LIVE:
        (tmp_path / f"{file.name}.d").mkdir()
        with_program(OPEN, tmp_path / f"{file.name}.d")
    command = ["systemd-analyze", "verify", str(unit)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    # unknown keys leave the exit status at 0 and are only printed
    assert (done.returncode, done.stderr) == (0, "")


@needs_systemd
@pytest.mark.parametrize("unit", [UNIT, LIVE])
def test_it_is_sandboxed(unit: Path) -> None:
    limit = f"--threshold={EXPOSURE * 10:.0f}"
    command = ["systemd-analyze", "security", "--offline=true", "--no-pager", limit, str(unit)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout.splitlines()[-1]


def test_it_has_no_network() -> None:
    families = settings()["RestrictAddressFamilies"]
    assert [set(value.split()) for value in families] == [{"AF_UNIX", "AF_NETLINK"}]


def test_the_live_page_has_one_port_and_only_this_computer_reaches_it() -> None:
    live = settings(LIVE)
    assert live["SocketBindDeny"] == ["any"] and live["SocketBindAllow"] == ["tcp:8600"]
    assert live["IPAddressDeny"] == ["any"] and live["IPAddressAllow"] == ["localhost"]
    # the recordings are out of its reach, and nobody else's socket is shown
    assert live["InaccessiblePaths"] == ["-/var/lib/calm-edge"]
    (command,) = live["ExecStart"]
    assert arguments_of(command).address == "127.0.0.1:8600"


def test_the_drop_in_opens_that_port_to_private_networks_with_a_token() -> None:
    opened = settings(OPEN)
    assert set(opened) == {"ExecStart", "IPAddressAllow"}
    (networks,) = opened["IPAddressAllow"]
    assert all(ip_network(network).is_private for network in networks.split())
    # the first, empty one replaces that of the unit
    empty, command = opened["ExecStart"]
    arguments = arguments_of(command)
    assert empty == "" and arguments.address == "0.0.0.0:8600"
    assert str(arguments.token_file).startswith(f"/var/lib/{settings(LIVE)['StateDirectory'][0]}/")


def test_both_services_use_the_same_socket() -> None:
    folder, name = load(DEPLOY / "calm-edge.toml").live.socket.rsplit("/", 1)
    assert folder == f"/run/{settings()['RuntimeDirectory'][0]}" and name
    for unit in (UNIT, LIVE):
        assert "--config /etc/calm-edge/calm-edge.toml" in settings(unit)["ExecStart"][0]
        assert settings(unit)["User"] == ["calm-edge"]


def arguments_of(command: str) -> argparse.Namespace:
    """What the command line makes of a unit's ExecStart."""
    return build_parser().parse_args(command.split()[1:])


def test_a_device_class_is_only_allowed_with_its_driver_loaded_before() -> None:
    allowed = {value.split()[0] for value in settings()["DeviceAllow"]}
    loaded = (DEPLOY / "calm-edge.modules-load.conf").read_text().split("\n")
    for device, driver in {
        "char-video4linux": "videodev",
        "char-ttyUSB": "usbserial",
        "char-ttyACM": "cdc_acm",
    }.items():
        assert device in allowed and driver in loaded


def test_a_stop_has_the_time_that_the_last_windows_may_take() -> None:
    # after that the recording is closed, and the trajectory written
    assert seconds("TimeoutStopSec") >= 2 * finish.LIVE_LIMIT_S
    assert settings()["KillMode"] == ["mixed"]
    assert settings()["SuccessExitStatus"] == [str(LOSS)]


def test_a_hang_is_ended_in_time_to_be_back_within_ten_seconds() -> None:
    # half of it is for the start, which loads a lot
    assert seconds("WatchdogSec") + seconds("RestartSec") <= 5
    stale_s = CaptureConfig().stale_after_ms / 1000
    assert seconds("WatchdogSec") > 2 * stale_s


def test_the_default_config_is_one_and_so_is_all_it_suggests(tmp_path: Path) -> None:
    default = DEPLOY / "calm-edge.toml"
    assert load(default).backbone.kit_file.startswith("/var/lib/calm-edge/")
    lines = all_switched_on(default.read_text())
    (tmp_path / "all.toml").write_text("\n".join(lines))
    config = load(tmp_path / "all.toml")
    assert len(lines) > 12
    assert config.capture.realtime_priority == 10 and config.scale.spacing_m == 0.52


def all_switched_on(text: str) -> list[str]:
    """The file with every suggested key switched on in place of the one it stands for."""
    switched: dict[str, dict[str, str]] = {}
    section: dict[str, str] = {}
    for line in text.splitlines():
        if line.startswith("["):
            section = switched.setdefault(line, {})
            continue
        key, equals, value = line.removeprefix("#").partition(" = ")
        if equals and key.isidentifier():
            section[key] = value
    return [
        line
        for name, keys in switched.items()
        for line in (name, *(f"{key} = {value}" for key, value in keys.items()))
    ]
