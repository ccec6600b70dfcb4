"""From the driver's buffer to the file: unchanged JPEG bytes, and every loss counted."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calm_edge.recording.reader import Recording
from calm_edge.recording.writer import RecordingWriter
from device.camera import CameraSpec, open_camera
from device.frame import Eye, jpeg
from tests.device.fake_video import FakeCamera, FakeVideoIO, Shot
from tests.manual_clock import ManualClock
from tests.recording import samples

S, MS = 1_000_000_000, 1_000_000


def test_mjpeg_bytes_are_recorded_unchanged_across_a_reconnect(tmp_path: Path) -> None:
    random = np.random.default_rng(7)
    clock = ManualClock(10 * S)
    sent = [jpeg(random.integers(0, 255, (8, int(n), 3), np.uint8)) for n in range(8, 88, 2)]
    fakes = FakeCamera("usb-1"), FakeCamera("usb-2")
    io = FakeVideoIO(clock, {"/dev/video0": fakes[0], "/dev/video2": fakes[1]})
    cameras = [
        open_camera(CameraSpec(eye, "v4l2", bus), clock, io=io)
        for eye, bus in ((Eye.PRIMARY, "usb-1"), (Eye.ASSISTANT, "usb-2"))
    ]
    for camera in cameras:
        camera.start()

    def shoot(fake: FakeCamera, k: int, sequence: int) -> None:
        t_ns = clock.now_ns() + MS
        # cameras pad their buffers
        fake.shots.append(Shot(t_ns, sequence, sent[k] + bytes(k), t_ns))

    with RecordingWriter(tmp_path, samples.config()) as writer:
        for k in range(0, 40, 2):
            if k == 20:
                fakes[0].gone = True
                assert cameras[0].read(0.1) is None
                # both node numbers are exchanged; the ports are the same
                fakes = FakeCamera("usb-1"), fakes[1]
                io.cameras = {"/dev/video2": fakes[0], "/dev/video0": fakes[1]}
                assert cameras[0].read(2.0) is None and cameras[0].connected
            for eye in Eye:
                # the third image of each eye is dropped
                if k == 4:
                    continue
                shoot(fakes[eye], k + eye, (k - 20 if k >= 20 and eye is Eye.PRIMARY else k) // 2)
                frame = cameras[eye].read(1.0)
                assert frame is not None
                writer.write_frame(frame)

    recording = Recording(tmp_path)
    for eye in Eye:
        stored = [frame.image for frame in recording.frames(eye)]
        assert stored == [sent[k + eye] for k in range(0, 40, 2) if k != 4]
        assert cameras[eye].stats().drops == 1
    assert [c.stats().reconnects for c in cameras] == [1, 0]
