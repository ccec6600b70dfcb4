"""Everything sent on the serial line is heard."""

from bench.spoilt.serial_line import SerialLine
from calm_edge.pose_output.mavlink import (
    Encoder,
    Heartbeat,
    Odometry,
    Severity,
    SystemState,
    status_texts,
)
from device.serial_port import SerialPort

TEXTS = ("calm-edge starting: no pose yet", "calm-edge running", "calm-edge lost: " + "x" * 80)


def _odometry(quality):
    zeros = {"velocity": (0.0,) * 3, "turn_rate": (0.0,) * 3, "pose_covariance": (0.0,) * 21}
    return Odometry(
        1, (0.0,) * 3, (1.0, 0.0, 0.0, 0.0), **zeros, velocity_covariance=(0.0,) * 21,
        reset_counter=1, quality=quality,
    )  # fmt: skip


def test_every_message_is_counted():
    encoder, qualities = Encoder(), [*range(100), 0, -1]
    with SerialLine() as line:
        port = SerialPort(line.port, 115_200, buffer_bytes=1 << 20)
        port.start()
        for quality in qualities:
            port.write(encoder.encode(_odometry(quality)))
            port.write(encoder.encode(Heartbeat(SystemState.ACTIVE)))
        for text in TEXTS:
            for message in status_texts(Severity.INFO, text, 1):
                port.write(encoder.encode(message))
        port.stop()
    assert line.qualities() == qualities
    assert len(line.payloads(Heartbeat)) == len(qualities)
    assert line.states() == ("starting", "running", "lost")


def test_a_line_on_which_nothing_is_sent():
    with SerialLine() as line:
        pass
    assert line.qualities() == []
