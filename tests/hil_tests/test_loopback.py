"""The pictures that go through the kernel and must come back unchanged."""

from __future__ import annotations

import cv2
import numpy as np

from device.frame import Eye
from hil_tests.vm.loopback_guest import SIZE, picture


def test_each_is_a_jpeg_unlike_the_others_that_an_encoder_would_not_give_back() -> None:
    pictures = [picture(eye, number) for eye in Eye for number in range(16)]
    assert len(set(pictures)) == len(pictures)
    assert picture(Eye.ASSISTANT, 3) == pictures[16 + 3]
    for data in pictures:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        assert image.shape[1::-1] == SIZE
        again = cv2.imencode(".jpg", image)[1].tobytes()
        assert b"number" in data and b"number" not in again
