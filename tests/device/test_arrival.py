import pytest

from device.arrival import STALLED_FRAMES, ArrivalCheck

S = 1_000_000_000


@pytest.mark.parametrize("late_ns", [-S // 2, 0, 30_000_000, S])
def test_stamps_near_their_arrival_are_used(late_ns: int) -> None:
    check = ArrivalCheck()
    assert all(check.usable(50 * S + k - late_ns, 50 * S + k) for k in range(3))
    assert check.reason == ""


@pytest.mark.parametrize(
    ("t_ns", "reason"),
    [(int(98.5 * S), "1.5 s old"), (0, "100.0 s old"), (1_700_000_000 * S, "in the future")],
)
def test_stamps_of_another_clock_are_not_used(t_ns: int, reason: str) -> None:
    check = ArrivalCheck()
    assert not any(check.usable(t_ns + k * S // 30, 100 * S + k * S // 30) for k in range(9))
    assert reason in check.reason


def test_a_few_late_frames_after_a_stall_keep_their_stamps() -> None:
    check = ArrivalCheck()
    assert check.usable(10 * S, 10 * S)
    assert all(check.usable(10 * S + k, 12 * S) for k in range(1, STALLED_FRAMES + 1))
    assert check.reason == "" and check.usable(12 * S, 12 * S)


def test_a_clock_that_is_set_in_mid_stream_is_noticed() -> None:
    for other in (-3600 * S, 3600 * S):
        check = ArrivalCheck()
        assert check.usable(9 * S, 9 * S)
        used = [check.usable(k * S // 30 + other, k * S // 30) for k in range(300, 360)]
        assert not any(used[STALLED_FRAMES:]) and check.reason
