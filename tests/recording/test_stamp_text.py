"""Times written in any usual way give the same stamps; what has two readings is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calm_edge.recording import SequenceError
from calm_edge.recording.stamp_text import read_stamps, stamps_in_names

T_NS = np.array([0, 100, 203, 300, 1400, 1500]) * 10**6
EPOCH_NS = 1_403_715_273_000_000_000


def lines(unit_ns: int, shift_ns: int = 0) -> str:
    return "".join(f"{(int(t) + shift_ns) // unit_ns}\n" for t in T_NS)


def seconds(separator: str = ".", end: str = "\n", after: str = "") -> str:
    return "".join(f"{t / 1e9:.6f}".replace(".", separator) + after + end for t in T_NS)


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        (seconds(), "s"),
        (lines(10**6), "ms"),
        (lines(10**3), "us"),
        (lines(1), "ns"),
        ("".join(f"{t / 1e6:.3f}\n" for t in T_NS), "ms"),
        (seconds(end="\r\n"), "s"),
        ("\ufeff" + seconds(end="\r\n"), "s"),
        ("# time [s]\n\n" + seconds() + "\n% end\n", "s"),
        ("timestamp [s]\n" + seconds(), "s"),
        (seconds(","), "s with a decimal comma"),
        (seconds(",", ";\n"), "s with a decimal comma"),
        (seconds(after=" cam0/00.jpg"), "s"),
        (seconds(after=",0.011"), "s"),
        ("".join(f"{k} {t / 1e9:.3f}\n" for k, t in enumerate(T_NS)), "s in the second column"),
        ("".join(f"{t // 10**9} {t % 10**9}\n" for t in T_NS), "s and ns in two columns"),
        ("".join(f"2011-09-26 13:02:2{t // 10**9}.{t % 10**9:09d}\n" for t in T_NS),
         "date and time"),
    ],
)  # fmt: skip
def test_all_usual_forms_give_the_same_stamps(tmp_path: Path, text: str, unit: str) -> None:
    file = tmp_path / "times0.txt"
    file.write_bytes(text.encode())
    rows = read_stamps(file)
    assert rows.unit == unit
    np.testing.assert_array_equal(rows.t_ns - rows.t_ns[0], T_NS)


@pytest.mark.parametrize(
    ("unit", "unit_ns"), [("s", 10**9), ("ms", 10**6), ("us", 1000), ("ns", 1)]
)
def test_dates_since_1970_are_read_in_their_unit(tmp_path: Path, unit: str, unit_ns: int) -> None:
    file = tmp_path / "data.csv"
    step_ns = 10**9 if unit == "s" else 50_000_000
    times = [EPOCH_NS + k * step_ns for k in range(9)]
    file.write_text(
        "#timestamp [ns],filename\n" + "".join(f"{t // unit_ns},{t}.png\n" for t in times)
    )
    rows = read_stamps(file)
    assert (rows.t_ns.tolist(), rows.unit) == (times, unit)
    assert rows.names[3] == f"{times[3]}.png" and rows.lines == tuple(range(2, 11))


def test_seconds_keep_nanoseconds(tmp_path: Path) -> None:
    file = tmp_path / "times.txt"
    file.write_text("-0.004\n0.000000001\n1403715273.262142976\n1403715273.312143001\n")
    assert read_stamps(file).t_ns.tolist() == [
        -4_000_000, 1, 1_403_715_273_262_142_976, 1_403_715_273_312_143_001,
    ]  # fmt: skip


def test_text_of_a_windows_console_is_read(tmp_path: Path) -> None:
    file = tmp_path / "times.txt"
    file.write_text(seconds(end="\r\n"), encoding="utf-16")
    assert read_stamps(file).t_ns.tolist() == T_NS.tolist()


def test_one_stamp_is_in_seconds_or_a_date(tmp_path: Path) -> None:
    file = tmp_path / "times.txt"
    for text, t_ns in [("12.5\n", 12_500_000_000), (f"{EPOCH_NS}\n", EPOCH_NS)]:
        file.write_text(text)
        assert read_stamps(file).t_ns.tolist() == [t_ns]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0.0\nnoon\n0.1\n", ":2: 'noon' is not a time"),
        ("0.0\n0.1\ninf\n", ":3: 'inf' is not a time"),
        ("0.0\n0.1\n" + "9" * 400 + "\n", "not a time"),
        ("0\n3\n6\n9\n", r"can be read as s \(0.333 Hz\) or ms \(333 Hz\); write seconds"),
        ("0,033\n1,066\n2,100\n", "can be read as"),
        ("0.1\n0.1\n0.1\n", "do not increase at the rate of a camera"),
        ("0.3\n0.2\n0.1\n0.0\n", "do not increase"),
    ],
)
def test_other_text_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "times0.txt"
    file.write_text(text)
    with pytest.raises(SequenceError, match=message) as error:
        read_stamps(file)
    assert str(file) in str(error.value) and "\n" not in str(error.value)


def test_names_that_are_dates_are_stamps() -> None:
    for unit, unit_ns in [("ms", 10**6), ("us", 10**3), ("ns", 1)]:
        times = [EPOCH_NS + k * 50_000_000 for k in range(5)]
        for prefix in ("", "left_", "frame-01-"):
            found = stamps_in_names([f"{prefix}{t // unit_ns}" for t in times])
            assert found is not None and found[1] == unit and found[0].tolist() == times
    found = stamps_in_names(["img_12.50", "img_12.60", "img_12.70"])
    assert found is not None and found[0].tolist() == [
        12_500_000_000,
        12_600_000_000,
        12_700_000_000,
    ]


@pytest.mark.parametrize(
    "stems",
    [["000000", "000001", "000002"], ["frame9990", "frame9991", "frame9992"], ["a", "b"],
     ["000000"], ["20180727_161127", "20180727_161128"], ["100", "200", "300"]],
)  # fmt: skip
def test_other_names_are_not_stamps(stems: list[str]) -> None:
    assert stamps_in_names(stems) is None
