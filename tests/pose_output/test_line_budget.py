from __future__ import annotations

import pytest

from calm_edge.config import Config, ConfigError, PoseOutputConfig
from calm_edge.pose_output.line_budget import bytes_per_second, check_rate


def test_the_line_budget_includes_every_message() -> None:
    # heartbeat, a text of four chunks, answers to twenty requests
    assert bytes_per_second(0.0) == 21 + 4 * 66 + 20 * 30
    assert bytes_per_second(30.0) - bytes_per_second(29.0) == 245


def test_a_line_too_slow_for_the_rate_raises() -> None:
    check_rate(Config().pose_output)
    check_rate(PoseOutputConfig(baud=115_200, rate_hz=38.0))
    with pytest.raises(ConfigError, match=r"baud = 115200: carries 38 poses.*rate_hz = 39"):
        check_rate(PoseOutputConfig(baud=115_200, rate_hz=39.0))
    with pytest.raises(ConfigError, match=r"baud = 57600: carries 17 poses"):
        check_rate(PoseOutputConfig(baud=57_600, rate_hz=30.0))
    with pytest.raises(ConfigError, match="carries 0 poses"):
        check_rate(PoseOutputConfig(baud=300))
    with pytest.raises(ConfigError, match="rate_hz = nan"):
        check_rate(PoseOutputConfig(rate_hz=float("nan")))
