"""Everything sent on the serial line is heard."""

import tty
from pathlib import Path

from bench.spoilt.serial_line import SerialLine
from calm_edge.pose_output.mavlink import (
    Encoder,
    Heartbeat,
    Odometry,
    Severity,
    SystemState,
    status_texts,
)

TEXTS = ("calm-edge starting: no pose yet", "calm-edge running", "calm-edge lost: " + "x" * 80)


def _odometry(quality):
    zeros = {"velocity": (0.0,) * 3, "turn_rate": (0.0,) * 3, "pose_covariance": (0.0,) * 21}
    return Odometry(
        1, (0.0,) * 3, (1.0, 0.0, 0.0, 0.0), **zeros, velocity_covariance=(0.0,) * 21,
        reset_counter=1, quality=quality,
    )  # fmt: skip


def test_every_message_is_counted():
    encoder, qualities = Encoder(), [*range(100), 0, -1]
    messages = [m for q in qualities for m in (_odometry(q), Heartbeat(SystemState.ACTIVE))]
    messages += [m for text in TEXTS for m in status_texts(Severity.INFO, text, 1)]
    with SerialLine() as line, Path(line.port).open("wb", buffering=0) as port:
        tty.setraw(port.fileno())
        for message in messages:
            port.write(encoder.encode(message))
    assert line.qualities() == qualities
    assert len(line.payloads(Heartbeat)) == len(qualities)
    assert line.states() == ("starting", "running", "lost")


def test_a_line_on_which_nothing_is_sent():
    with SerialLine() as line:
        pass
    assert line.qualities() == []
