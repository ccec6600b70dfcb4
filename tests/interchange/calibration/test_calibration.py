import pytest

from calm_edge.interchange.calibration.calibration import CalibrationError
from calm_edge.interchange.calibration.formats import read

ROW = "{n} OPENCV 640 480 500 510 322 238 -0.2 0.05 0.001 -0.002\n"


def files(folder, *counts):
    out = []
    for number, count in enumerate(counts):
        path = folder / f"camera{number}.txt"
        path.write_text("".join(ROW.format(n=n + 1) for n in range(count)))
        out.append(path)
    return tuple(out)


@pytest.mark.parametrize("counts", [(1,), (2,), (1, 1)])
def test_one_or_two_cameras_are_taken(tmp_path, counts):
    assert len(read(files(tmp_path, *counts)).cameras) == sum(counts)


@pytest.mark.parametrize(
    ("counts", "message"),
    [((3,), "holds 3 cameras"), ((2, 1), "must hold one"), ((1, 1, 1), "or one per camera")],
)
def test_other_numbers_of_cameras_are_refused(tmp_path, counts, message):
    with pytest.raises(CalibrationError, match=message):
        read(files(tmp_path, *counts))


@pytest.mark.parametrize("content", [b"", b"hello", b"\x00\xff" * 50, b"a: 1\n", b"[]"])
def test_other_files_are_refused_by_name(tmp_path, content):
    (tmp_path / "any").write_bytes(content)
    with pytest.raises(CalibrationError, match="any: not a calibration of"):
        read((tmp_path / "any",))


def test_a_missing_file_and_a_folder_are_refused_by_name(tmp_path):
    for path in (tmp_path / "none.yaml", tmp_path):
        with pytest.raises(CalibrationError, match="cannot be read"):
            read((path,))
