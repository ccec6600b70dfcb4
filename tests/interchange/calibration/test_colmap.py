"""COLMAP's models: pixels of POINTS as computed by pycolmap 4.2.1, in our pixel convention."""

import struct
from operator import attrgetter

import numpy as np
import pytest

from calm_edge.geometry import se3
from calm_edge.interchange.calibration.calibration import CalibrationError
from calm_edge.interchange.calibration.colmap import _MODELS
from calm_edge.interchange.calibration.formats import read
from calm_edge.interchange.calibration.lens import Lens

POINTS = np.array([[0.1, 0.05, 1], [-0.6, 0.3, 1], [0.7, -0.5, 1], [0.2, 0.55, 1.0]])
COLMAP_UV = {
    "SIMPLE_PINHOLE": (
        [500, 320, 240],
        [[370.0, 265.0], [20.0, 390.0], [670.0, -10.0], [420.0, 515.0]],
    ),
    "PINHOLE": (
        [500, 510, 322, 238],
        [[372.0, 263.5], [22.0, 391.0], [672.0, -17.0], [422.0, 518.5]],
    ),
    "SIMPLE_RADIAL": (
        [500, 320, 240, -0.1],
        [[369.9375, 264.96875], [33.5, 383.25], [644.1, 8.5], [416.575, 505.58125]],
    ),
    "RADIAL": (
        [500, 320, 240, -0.2, 0.05],
        [
            [369.875391, 264.937695],
            [43.9625, 378.01875],
            [627.783, 20.155],
            [413.736531, 497.775461],
        ],
    ),
    "OPENCV": (
        [500, 510, 322, 238, -0.2, 0.05, 0.001, -0.002],
        [
            [371.847891, 263.435174],
            [44.6125, 379.467625],
            [627.713, 15.1045],
            [415.424031, 501.189795],
        ],
    ),
    "OPENCV_FISHEYE": (
        [300, 310, 322, 238, -0.02, 0.01, -0.003, 0.001],
        [
            [351.868568, 253.432093],
            [164.38391, 319.43498],
            [494.05964, 111.003599],
            [376.020106, 391.507133],
        ],
    ),
    "FULL_OPENCV": (
        [500, 510, 322, 238, -0.2, 0.05, 0.001, -0.002, 0.01, 0.1, 0.02, 0.003],
        [
            [371.785469, 263.403339],
            [57.327099, 372.983179],
            [604.601779, 31.942675],
            [412.142986, 491.986462],
        ],
    ),
    "FOV": (
        [300, 310, 322, 238, 0.8],
        [
            [353.615525, 254.334688],
            [148.934937, 327.416949],
            [513.902811, 96.357449],
            [380.89078, 405.347966],
        ],
    ),
    "SIMPLE_RADIAL_FISHEYE": (
        [300, 320, 240, 0.02],
        [
            [349.883337, 254.941668],
            [160.345126, 319.827437],
            [495.174469, 114.875379],
            [374.589468, 390.121037],
        ],
    ),
    "RADIAL_FISHEYE": (
        [300, 320, 240, 0.02, -0.01],
        [
            [349.883291, 254.941645],
            [160.538383, 319.730808],
            [494.732764, 115.190883],
            [374.546799, 390.003696],
        ],
    ),
    "THIN_PRISM_FISHEYE": (
        [300, 310, 322, 238, -0.02, 0.01, 0.001, -0.002, -0.003, 0.001, 0.002, -0.001],
        [
            [351.859642, 253.427482],
            [163.964953, 319.651441],
            [493.51541, 111.405293],
            [376.03484, 391.549003],
        ],
    ),
    "RAD_TAN_THIN_PRISM_FISHEYE": (
        [
            300,
            310,
            322,
            238,
            -0.02,
            0.01,
            -0.003,
            0.001,
            0.0005,
            -0.0002,
            0.001,
            -0.002,
            0.002,
            -0.001,
            0.0005,
            0.0003,
        ],
        [
            [351.879673, 253.426346],
            [164.989616, 319.11465],
            [494.914294, 110.440089],
            [376.159347, 391.136547],
        ],
    ),
    "SIMPLE_DIVISION": (
        [400, 320, 240, -0.2],
        [
            [359.900497, 259.950248],
            [98.412828, 350.793586],
            [567.596455, 63.145389],
            [395.162677, 446.697362],
        ],
    ),
    "DIVISION": (
        [400, 410, 322, 238, -0.2],
        [
            [361.900497, 258.449005],
            [100.412828, 351.563426],
            [569.596455, 56.724024],
            [397.162677, 449.864796],
        ],
    ),
    "SIMPLE_FISHEYE": (
        [300, 320, 240],
        [
            [349.875929, 254.937965],
            [161.452204, 319.273898],
            [493.424015, 116.125704],
            [374.285079, 389.283967],
        ],
    ),
    "FISHEYE": (
        [300, 310, 322, 238],
        [
            [351.875929, 253.435897],
            [163.452204, 319.916361],
            [495.424015, 109.996561],
            [376.285079, 392.260099],
        ],
    ),
    "EUCM": (
        [300, 310, 322, 238, 0.6, 1.1],
        [
            [351.877177, 253.436542],
            [163.216795, 320.037989],
            [495.825389, 109.700308],
            [376.347337, 392.437015],
        ],
    ),
}
# as written by pycolmap: the second camera turned by 0.1 rad about y, from the first
RIGS_TXT = (
    "# Number of rigs: 1\n1 2 CAMERA 1 CAMERA 2 1 "
    "0.99875026039496628 0 0.049979169270678331 0 -0.5 0.01 0.02\n"
)
RIGS_BIN = struct.pack(
    "<QIIiIiIB7d", 1, 1, 2, 0, 1, 0, 2, 1,
    0.99875026039496628, 0, 0.049979169270678331, 0, -0.5, 0.01, 0.02,
)  # fmt: skip


def text(path, *models):
    rows = [
        f"{n} {m} 640 480 {' '.join(map(str, COLMAP_UV[m][0]))}" for n, m in enumerate(models, 1)
    ]
    path.write_text(
        "# Camera list\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n" + "\n".join(rows)
    )
    return path


@pytest.mark.parametrize("model", COLMAP_UV)
def test_every_model_projects_as_in_colmap(tmp_path, model):
    each = read((text(tmp_path / "cameras.txt", model),)).cameras[0]
    expected = np.array(COLMAP_UV[model][1]) - 0.5
    inside = ((expected > 0) & (expected < [639, 479])).all(1)
    off = np.abs(each.camera.project(POINTS) - expected)[inside].max()
    assert off < max(1e-5, each.fit_px) and each.fit_px < 2.5


@pytest.mark.parametrize(
    "model", [model for model in _MODELS if model.plane], ids=attrgetter("name")
)
def test_the_lenses_that_are_fitted_are_those_of_colmap(model):
    params, expected = COLMAP_UV[model.name]
    focals, k = params[: model.focals], params[model.focals + 2 :]
    lens = Lens(model.plane(k), focals[0], focals[-1], *params[model.focals :][:2], 640, 480)
    assert np.allclose(lens.project(POINTS), expected, atol=1e-5)


def binary(path):
    numbers = {"OPENCV": 4, "OPENCV_FISHEYE": 5}
    rows = [
        struct.pack("<IiQQ8d", n, numbers[m], 640, 480, *COLMAP_UV[m][0])
        for n, m in enumerate(numbers, 1)
    ]
    path.write_bytes(struct.pack("<Q", len(rows)) + b"".join(rows))
    return path


@pytest.mark.parametrize("rigs", [True, False])
def test_text_and_binary_hold_the_same(tmp_path, rigs):
    files = (
        text(tmp_path / "cameras.txt", "OPENCV", "OPENCV_FISHEYE"),
        binary(tmp_path / "cameras.bin"),
    )
    if rigs:
        (tmp_path / "rigs.txt").write_text(RIGS_TXT)
        (tmp_path / "rigs.bin").write_bytes(RIGS_BIN)
    from_text, from_binary = (read((path,)) for path in files)
    assert from_text.cameras == from_binary.cameras
    for found in (from_text, from_binary):
        assert (found.T_p_a is not None) == rigs and found.spacing_m is None
        if found.T_p_a is not None:
            T_a_p = se3.inverse(found.T_p_a)
            assert np.allclose(se3.so3_log(T_a_p[:3, :3]), [0, 0.1, 0], atol=1e-9)
            assert np.allclose(T_a_p[:3, 3], [-0.5, 0.01, 0.02])


def test_cameras_are_in_the_order_of_their_ids(tmp_path):
    path = text(tmp_path / "cameras.txt", "PINHOLE", "SIMPLE_RADIAL")
    first, second = path.read_text().splitlines()[2:]
    path.write_text(f"{second}\n{first}\n")
    assert [each.camera.fy for each in read((path,)).cameras] == [510.0, 500.0]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("cameras.txt", b"1 MYSTERY 640 480 1 2 3\n", "model MYSTERY is not supported"),
        ("cameras.txt", b"1 PINHOLE 640 480 500\n", "PINHOLE parameters has 1 numbers, not 4"),
        ("cameras.txt", b"1 PINHOLE 640\n", "damaged"),
        ("cameras.txt", b"# nothing\n", "holds no camera"),
        ("cameras.txt", b"\xff\xfe\x00", "damaged"),
        ("cameras.bin", b"", "damaged"),
        ("cameras.bin", struct.pack("<QIiQQ", 1, 1, 99, 640, 480), "unknown model 99"),
        ("cameras.bin", struct.pack("<QIiQQ", 10**9, 1, 1, 640, 480), "damaged"),
    ],
)
def test_wrong_content_is_one_line(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(CalibrationError, match=message) as caught:
        read((tmp_path / name,))
    assert name in str(caught.value) and "\n" not in str(caught.value)


def test_a_damaged_rigs_file_is_named(tmp_path):
    (tmp_path / "rigs.txt").write_text("1 2 CAMERA 1 CAMERA 2 1 0.9")
    with pytest.raises(CalibrationError, match=r"rigs\.txt: damaged"):
        read((text(tmp_path / "cameras.txt", "OPENCV", "OPENCV"),))
