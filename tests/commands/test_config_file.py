from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from calm_edge.commands.config_file import with_keys, write_keys
from calm_edge.config import ConfigError, load

PAIR = {"primary": "v4l2:usb-1", "assistant": 'v4l2:odd "name"'}
KIT = """\
# my kit
[scale]
spacing_m = 0.52  # tape

[capture]  # both eyes
  primary = 'v4l2:'   # left
rate_hz = 15.0
#assistant = "v4l2:usb-9"
[backbone]
primary = "not this one"
"""


def test_only_the_two_values_change() -> None:
    changed = with_keys(KIT.replace('primary = "not this one"\n', ""), {"capture": PAIR})
    assert tomllib.loads(changed)["capture"] == PAIR | {"rate_hz": 15.0}
    assert '  primary = "v4l2:usb-1"   # left\n' in changed
    for line in ("# my kit", "spacing_m = 0.52  # tape", '#assistant = "v4l2:usb-9"'):
        assert line + "\n" in changed


def test_the_same_key_in_another_section_is_unchanged() -> None:
    assert tomllib.loads(with_keys(KIT, {"capture": PAIR}))["backbone"]["primary"] == "not this one"


@pytest.mark.parametrize("text", ["", "[scale]\nspacing_m = 1.0", "[capture]", "[capture]\n\n"])
def test_a_missing_section_or_key_is_added(text: str) -> None:
    after = tomllib.loads(with_keys(text, {"capture": PAIR}))
    assert after.pop("capture") == PAIR
    assert after == {k: v for k, v in tomllib.loads(text).items() if k != "capture"}


@pytest.mark.parametrize(
    "text",
    [
        "capture = {rate_hz = 5.0}\n",
        "capture.rate_hz = 5.0\n",
        '[capture]\nprimary = """v4l2:\n"""\n',
        'note = """\n[capture]\n"""\n',
    ],
)
def test_other_ways_to_write_a_table_are_kept(text: str) -> None:
    before = tomllib.loads(text)
    after = tomllib.loads(with_keys(text, {"capture": PAIR}))
    assert after == before | {"capture": before.get("capture", {}) | PAIR}


def test_several_sections_and_types_are_set_at_once() -> None:
    changed = with_keys(KIT, {"scale": {"spacing_m": 0.6}, "loops": {"enabled": False}})
    assert "spacing_m = 0.6  # tape\n" in changed
    assert tomllib.loads(changed)["loops"] == {"enabled": False}


def test_a_value_in_place_of_a_section_raises() -> None:
    with pytest.raises(ConfigError, match="capture: expected a table"):
        with_keys("capture = 3\n", {"capture": PAIR})


def test_the_file_is_replaced_atomically_and_can_be_loaded(tmp_path: Path) -> None:
    path = tmp_path / "kit.toml"
    path.write_text(KIT.replace('primary = "not this one"\n', ""))
    path.chmod(0o640)
    write_keys(path, {"capture": PAIR})
    config = load(path)
    assert (config.capture.primary, config.capture.assistant) == tuple(PAIR.values())
    assert config.scale.spacing_m == 0.52 and config.capture.rate_hz == 15.0
    assert path.stat().st_mode & 0o777 == 0o640
    assert [p.name for p in tmp_path.iterdir()] == ["kit.toml"]


def test_errors_are_one_line_with_the_file(tmp_path: Path) -> None:
    broken = tmp_path / "kit.toml"
    broken.write_text("[capture\n")
    with pytest.raises(ConfigError, match=r"kit\.toml: not"):
        write_keys(broken, {"capture": PAIR})
    assert broken.read_text() == "[capture\n"
    broken.write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match=r"kit\.toml: not"):
        write_keys(broken, {"capture": PAIR})
    with pytest.raises(ConfigError, match=r"none/kit\.toml: cannot be written"):
        write_keys(tmp_path / "none/kit.toml", {"capture": PAIR})


def test_a_byte_order_mark_and_other_line_ends_are_read(tmp_path: Path) -> None:
    path = tmp_path / "kit.toml"
    text = "[scale]\r\nspacing_m = 0.52\r\n"
    path.write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert load(path).scale.spacing_m == 0.52
    write_keys(path, {"capture": PAIR})
    assert load(path).capture.primary == PAIR["primary"]
    path.write_text(text, encoding="utf-16")
    with pytest.raises(ConfigError, match=r"kit\.toml: not UTF-8 text; save it as UTF-8"):
        load(path)


@pytest.mark.parametrize("value", ["8000", '"auto-then-lock"'])
def test_a_control_is_a_number_or_a_word(tmp_path: Path, value: str) -> None:
    (tmp_path / "kit.toml").write_text(f"[capture]\nexposure_us = {value}\n")
    assert load(tmp_path / "kit.toml").capture.exposure_us == tomllib.loads(f"v = {value}")["v"]
    (tmp_path / "kit.toml").write_text("[capture]\nexposure_us = 1.5\n")
    with pytest.raises(ConfigError, match=r"capture\.exposure_us: expected int, got 1\.5"):
        load(tmp_path / "kit.toml")
