"""What the page of the set-up shows of each stage."""

from __future__ import annotations

import json
from pathlib import Path

from calm_edge.commands.finding import bad, good, note
from calm_edge.commands.setup_choices import Choices
from calm_edge.commands.setup_state import SetupState, Stage, judgement
from calm_edge.config import Config
from device.camera import FoundCamera

A, B = (FoundCamera(f"v4l2:usb-{k}", f"Camera {k}", f"/dev/video{k}") for k in range(2))


def test_every_stage_has_a_sentence() -> None:
    choices = Choices(Config())
    choices.take([A, B])
    for stage in Stage:
        state = SetupState(Path("kit.toml"), False, stage, "two cameras")
        content = state.content(choices)
        assert json.loads(json.dumps(content)) == content
        assert content["sentence"].endswith((".", "...", "two cameras")), stage
        assert content["ended"] == (stage is Stage.ENDED)


def test_too_few_cameras_are_counted_with_what_to_plug_in() -> None:
    content = SetupState(Path("kit.toml"), False, Stage.FEW, cameras=[A]).content(Choices(Config()))
    assert content["level"] == "bad" and not content["chosen"]
    assert content["sentence"].startswith("1 of 2 cameras found. Plug in two USB cameras")


def test_the_worst_light_is_the_sentence() -> None:
    fine, dim = good("overlap", "500 points"), note("primary focus", "soft", "turn the ring")
    assert judgement([fine]) == ("good", "Both cameras are fine.")
    assert judgement([fine, dim])[0] == "warning" and "primary focus" in judgement([fine, dim])[1]
    level, sentence = judgement([dim, bad("overlap", "3 points"), bad("assistant rate", "0 Hz")])
    assert level == "bad" and sentence.endswith(": overlap, assistant rate.")


def test_keys_to_write_or_why_they_cannot_be() -> None:
    choices, state = Choices(Config()), SetupState(Path("kit.toml"), True)
    choices.set_spacing(0.52)
    assert state.content(choices)["keys"] == ["scale.spacing_m = 0.52"]
    choices.set_ports("/dev/ttyUSB0", "/dev/ttyUSB0")
    content = state.content(choices)
    assert content["keys"] == [] and "pose_output.port as well" in content["objection"]


def test_the_end_names_the_next_command() -> None:
    choices, state = Choices(Config()), SetupState(Path("a kit.toml"), False, Stage.ENDED)
    assert "nothing was written" in state.content(choices)["sentence"]
    state.written = True
    assert "record --config 'a kit.toml'" in state.content(choices)["sentence"]
    state.startable = True
    assert "sudo sh -c" in state.content(choices)["sentence"]
    state.started = True
    assert state.content(choices)["sentence"] == "a kit.toml is written. The service records."
