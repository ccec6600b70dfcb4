"""Samples of a drive: pairs of neighbours, few of them, and what they say."""

from __future__ import annotations

import cv2
import numpy as np

from calm_edge.daemon.picture_samples import PictureSamples
from calm_edge.frontend.diagnosis import Kind
from device.frame import Eye, Frame


def jpeg(level: int) -> bytes:
    return bytes(cv2.imencode(".jpg", np.full((60, 80), level, np.uint8))[1])


def test_an_hour_leaves_a_few_neighbours_of_each_camera() -> None:
    samples = PictureSamples()
    for k in range(100_000):
        samples.add(Frame(Eye.PRIMARY, k, k, b""))
        samples.add(Frame(Eye.ASSISTANT, k, k, b""))
    kept = samples._frames[Eye.PRIMARY]
    assert len(kept) == len(samples._frames[Eye.ASSISTANT]) < 40
    assert [f.sequence for f in kept[:7]] == [0, 1, 2, 3, 4, 7, 8]
    samples.clear()
    assert not samples._frames[Eye.PRIMARY]


def test_they_name_the_cause() -> None:
    samples = PictureSamples()
    assert samples.causes()[0].kind is Kind.MISSING
    for k in range(8):
        for eye, level in ((Eye.PRIMARY, 5), (Eye.ASSISTANT, 5)):
            samples.add(Frame(eye, k, k * 10**8, jpeg(level)))
    assert [cause.kind for cause in samples.causes()] == [Kind.EXPOSURE] * 2
