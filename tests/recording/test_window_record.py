"""Windows are rebuilt from the recording exactly."""

from __future__ import annotations

import pytest

from calm_edge.recording.window_record import of_window, rebuild
from device.frame import Eye, Frame
from tests.recording import samples


@pytest.mark.parametrize("loop", [True, False])
def test_a_rebuilt_window_equals_the_original(loop: bool) -> None:
    window = samples.window(4, loop)

    def fetch(eye: Eye, sequence: int, t_ns: int) -> Frame:
        frame = samples.frame(eye, sequence)
        assert frame.t_ns == t_ns
        return frame

    assert rebuild(of_window(window), fetch) == window
