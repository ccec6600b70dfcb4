"""Fixes of NMEA sentences, in whatever pieces they arrive."""

from __future__ import annotations

import math

import pytest

from device.gps.fix import NO_HEIGHT_SIGMA_M, FixKind
from device.gps.nmea import LONGEST_LINE, NmeaParser
from tests.device.gps.sentences import measurement, sentence

T_NS = 1_700_000_000_250_000_000


def test_a_measurement_is_a_fix_with_its_quality_and_height_over_the_ellipsoid() -> None:
    parser = NmeaParser()
    text = measurement(T_NS, -33.5, 151.25, 120.0).encode()
    assert parser.feed(text, 77) == []
    (fix,) = parser.flush()
    assert fix.t_ns == 77 and fix.utc_ns == T_NS
    assert fix.lla == pytest.approx((-33.5, 151.25, 120.0), abs=1e-8)
    assert fix.kind is FixKind.THREE_D and fix.hdop == 0.9 and fix.satellites == 9
    assert fix.sigma_m == pytest.approx((2.5 * 0.9 / 2**0.5,) * 2 + (2.5 * 1.3,))
    assert not fix.measured and parser.skipped == 0


@pytest.mark.parametrize("size", [1, 7, 64, 4096])
def test_pieces_of_any_size_give_the_same_fixes(size: int) -> None:
    data = "".join(measurement(T_NS + k * 10**9, 48.0, 11.0, 500.0) for k in range(5)).encode()
    parser = NmeaParser()
    fixes = []
    for start in range(0, len(data), size):
        fixes += parser.feed(data[start : start + size], start)
    fixes += parser.flush()
    assert [fix.utc_ns for fix in fixes] == [T_NS + k * 10**9 for k in range(5)]
    # arrival of the first byte of a measurement
    assert fixes[1].t_ns == pytest.approx(len(data) / 5, abs=size)


def test_garbage_and_sentences_with_a_wrong_checksum_are_skipped() -> None:
    good = measurement(T_NS, 48.0, 11.0, 500.0)
    wrong = measurement(T_NS + 10**9, 49.0, 11.0, 500.0).replace("4900.0", "4901.0")
    parser = NmeaParser()
    noise = bytes(range(128, 256)) * 30 + b"\n$GPGGA,rubbish\n$\n\r\n"
    fixes = parser.feed(noise + good.encode() + noise + wrong.encode(), 0) + parser.flush()
    assert [fix.lla[0] for fix in fixes] == [48.0]
    assert parser.sentences == 4 and parser.skipped > 3
    assert len(parser._line) <= LONGEST_LINE


@pytest.mark.parametrize(
    ("quality", "kind"),
    [(0, FixKind.NONE), (2, FixKind.DIFFERENTIAL), (4, FixKind.RTK), (6, FixKind.ESTIMATED)],
)
def test_the_kind_of_fix_sets_its_sigma(quality: int, kind: FixKind) -> None:
    parser = NmeaParser()
    parser.feed(measurement(T_NS, 48.0, 11.0, 500.0, quality=quality).encode(), 0)
    (fix,) = parser.flush()
    assert fix.kind is kind and fix.has_position is (quality > 0)
    if quality == 4:
        assert fix.sigma_m[0] < 0.05
    if quality == 6:
        assert fix.sigma_m[0] > 10


def test_the_receiver_s_own_sigmas_are_taken() -> None:
    parser = NmeaParser()
    text = measurement(T_NS, 48.0, 11.0, 500.0)
    clock = text.split(",")[1]
    parser.feed((text + sentence(f"GPGST,{clock},9.0,,,,1.5,2.5,4.0")).encode(), 0)
    (fix,) = parser.flush()
    assert fix.measured and fix.sigma_m == (2.5, 1.5, 4.0)


def test_rmc_alone_is_a_position_of_unknown_height_and_quality() -> None:
    parser = NmeaParser()
    parser.feed(measurement(T_NS, 48.0, 11.0, 500.0).split("\r\n")[0].encode() + b"\r\n", 0)
    (fix,) = parser.flush()
    assert fix.lla == (48.0, 11.0, 0.0) and fix.sigma_m[2] == NO_HEIGHT_SIGMA_M
    assert fix.kind is FixKind.UNKNOWN and math.isnan(fix.hdop)


def test_a_measurement_without_a_date_is_of_the_day_of_the_one_before() -> None:
    midnight = 1_700_006_400 * 10**9
    before = measurement(midnight - 10**9, 48.0, 11.0, 500.0)
    after = measurement(midnight + 10**9, 48.0, 11.0, 500.0)
    gga = after.split("\r\n")[1] + "\r\n"
    parser = NmeaParser()
    assert [f.utc_ns for f in parser.feed((gga + before + gga).encode(), 0) + parser.flush()] == [
        None,
        midnight - 10**9,
        midnight + 10**9,
    ]
