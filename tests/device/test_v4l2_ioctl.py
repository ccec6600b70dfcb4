"""The packed structs against a C program that includes the kernel's header."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from device.drivers import v4l2_controls as controls
from device.drivers import v4l2_ioctl as v4l2
from device.drivers import v4l2_modes as modes

HEADER = Path("/usr/include/linux/videodev2.h")
# name in the header -> our value: sizes, offsets and request numbers
EXPECTED = {
    "sizeof(struct v4l2_capability)": v4l2.CAPABILITY.size,
    "sizeof(struct v4l2_fmtdesc)": v4l2.FMTDESC.size,
    "sizeof(struct v4l2_format)": v4l2.FORMAT.size,
    "sizeof(struct v4l2_streamparm)": v4l2.STREAMPARM.size,
    "sizeof(struct v4l2_requestbuffers)": v4l2.REQUESTBUFFERS.size,
    "sizeof(struct v4l2_buffer)": v4l2.BUFFER.size,
    "sizeof(struct v4l2_queryctrl)": controls.QUERY.size,
    "sizeof(struct v4l2_control)": controls.CONTROL.size,
    "sizeof(struct v4l2_frmsizeenum)": modes.FRAMESIZE.size,
    "sizeof(struct v4l2_frmivalenum)": modes.FRAMEINTERVAL.size,
    "VIDIOC_QUERYCTRL": controls.QUERYCTRL,
    "VIDIOC_G_CTRL": controls.G_CTRL,
    "VIDIOC_S_CTRL": controls.S_CTRL,
    "VIDIOC_ENUM_FRAMESIZES": modes.ENUM_FRAMESIZES,
    "VIDIOC_ENUM_FRAMEINTERVALS": modes.ENUM_FRAMEINTERVALS,
    "V4L2_FRMSIZE_TYPE_DISCRETE": modes.DISCRETE,
    "V4L2_FRMIVAL_TYPE_DISCRETE": modes.DISCRETE,
    "V4L2_CTRL_FLAG_DISABLED": controls.FLAG_DISABLED,
    "V4L2_CTRL_FLAG_READ_ONLY": controls.FLAG_READ_ONLY,
    "V4L2_CTRL_FLAG_NEXT_CTRL": controls.FLAG_NEXT,
    "V4L2_CTRL_TYPE_CTRL_CLASS": controls.TYPE_CLASS,
    "V4L2_CID_AUTO_WHITE_BALANCE": controls.AUTO_WHITE_BALANCE,
    "V4L2_CID_AUTOGAIN": controls.AUTOGAIN,
    "V4L2_CID_GAIN": controls.GAIN,
    "V4L2_CID_WHITE_BALANCE_TEMPERATURE": controls.WHITE_BALANCE_TEMPERATURE,
    "V4L2_CID_EXPOSURE_AUTO": controls.EXPOSURE_AUTO,
    "V4L2_CID_EXPOSURE_ABSOLUTE": controls.EXPOSURE_ABSOLUTE,
    "V4L2_CID_EXPOSURE_AUTO_PRIORITY": controls.EXPOSURE_AUTO_PRIORITY,
    "V4L2_CID_FOCUS_ABSOLUTE": controls.FOCUS_ABSOLUTE,
    "V4L2_CID_FOCUS_AUTO": controls.FOCUS_AUTO,
    "V4L2_CID_ANALOGUE_GAIN": controls.ANALOGUE_GAIN,
    "V4L2_EXPOSURE_MANUAL": controls.CONTROL_GROUPS[0].off,
    "V4L2_EXPOSURE_APERTURE_PRIORITY": controls.CONTROL_GROUPS[0].on[0],
    "V4L2_EXPOSURE_AUTO": controls.CONTROL_GROUPS[0].on[1],
    "VIDIOC_QUERYCAP": v4l2.QUERYCAP,
    "VIDIOC_ENUM_FMT": v4l2.ENUM_FMT,
    "VIDIOC_S_FMT": v4l2.S_FMT,
    "VIDIOC_S_PARM": v4l2.S_PARM,
    "VIDIOC_REQBUFS": v4l2.REQBUFS,
    "VIDIOC_QUERYBUF": v4l2.QUERYBUF,
    "VIDIOC_QBUF": v4l2.QBUF,
    "VIDIOC_DQBUF": v4l2.DQBUF,
    "VIDIOC_STREAMON": v4l2.STREAMON,
    "VIDIOC_STREAMOFF": v4l2.STREAMOFF,
    "V4L2_CAP_VIDEO_CAPTURE": v4l2.CAP_VIDEO_CAPTURE,
    "V4L2_CAP_STREAMING": v4l2.CAP_STREAMING,
    "V4L2_CAP_DEVICE_CAPS": v4l2.CAP_DEVICE_CAPS,
    "V4L2_BUF_TYPE_VIDEO_CAPTURE": v4l2.BUF_TYPE_VIDEO_CAPTURE,
    "V4L2_FIELD_NONE": v4l2.FIELD_NONE,
    "V4L2_MEMORY_MMAP": v4l2.MEMORY_MMAP,
    "V4L2_BUF_FLAG_ERROR": v4l2.BUF_FLAG_ERROR,
    "V4L2_BUF_FLAG_TIMESTAMP_MASK": v4l2.BUF_FLAG_TIMESTAMP_MASK,
    "V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC": v4l2.BUF_FLAG_TIMESTAMP_MONOTONIC,
}
# the fields that the driver reads or writes, each with a distinct value
FILLED = {
    "struct v4l2_capability": (
        v4l2.CAPABILITY,
        {".capabilities": (4, 11), ".device_caps": (5, 12), ".version": (3, 13)},
    ),
    "struct v4l2_fmtdesc": (v4l2.FMTDESC, {".index": (0, 11), ".pixelformat": (4, 12)}),
    "struct v4l2_format": (
        v4l2.FORMAT,
        {
            ".type": (0, 11),
            ".fmt.pix.width": (1, 12),
            ".fmt.pix.height": (2, 13),
            ".fmt.pix.pixelformat": (3, 14),
            ".fmt.pix.field": (4, 15),
            ".fmt.pix.bytesperline": (5, 16),
            ".fmt.pix.sizeimage": (6, 17),
        },
    ),
    "struct v4l2_streamparm": (
        v4l2.STREAMPARM,
        {
            ".type": (0, 11),
            ".parm.capture.timeperframe.numerator": (3, 12),
            ".parm.capture.timeperframe.denominator": (4, 13),
        },
    ),
    "struct v4l2_requestbuffers": (
        v4l2.REQUESTBUFFERS,
        {".count": (0, 11), ".type": (1, 12), ".memory": (2, 13)},
    ),
    "struct v4l2_queryctrl": (
        controls.QUERY,
        {
            ".id": (0, 11),
            ".type": (1, 12),
            ".minimum": (3, 13),
            ".maximum": (4, 14),
            ".step": (5, 15),
            ".default_value": (6, 16),
            ".flags": (7, 17),
        },
    ),
    "struct v4l2_control": (controls.CONTROL, {".id": (0, 11), ".value": (1, 12)}),
    "struct v4l2_frmsizeenum": (
        modes.FRAMESIZE,
        {
            ".index": (0, 11),
            ".pixel_format": (1, 12),
            ".type": (2, 13),
            ".stepwise.min_width": (3, 14),
            ".stepwise.max_width": (4, 15),
            ".stepwise.min_height": (6, 16),
            ".stepwise.max_height": (7, 17),
        },
    ),
    "struct v4l2_frmivalenum": (
        modes.FRAMEINTERVAL,
        {
            ".index": (0, 11),
            ".pixel_format": (1, 12),
            ".width": (2, 13),
            ".height": (3, 14),
            ".type": (4, 15),
            ".stepwise.min.numerator": (5, 16),
            ".stepwise.min.denominator": (6, 17),
            ".stepwise.max.numerator": (7, 18),
            ".stepwise.max.denominator": (8, 19),
        },
    ),
    "struct v4l2_buffer": (
        v4l2.BUFFER,
        {
            ".index": (0, 11),
            ".type": (1, 12),
            ".bytesused": (2, 13),
            ".flags": (3, 14),
            ".field": (4, 15),
            ".timestamp.tv_sec": (5, 16),
            ".timestamp.tv_usec": (6, 17),
            ".sequence": (7, 18),
            ".memory": (8, 19),
            ".m.offset": (9, 20),
            ".length": (10, 21),
        },
    ),
}


def compiled(tmp_path: Path, body: str) -> list[str]:
    """Compile a C program that includes the header and return the lines it prints."""
    source, program = tmp_path / "probe.c", tmp_path / "probe"
    source.write_text(
        "#include <linux/videodev2.h>\n#include <stdio.h>\n#include <string.h>\n"
        f"int main(void) {{\n{body}\nreturn 0;\n}}\n"
    )
    subprocess.run(["gcc", "-w", "-o", program, source], check=True)
    return subprocess.run([program], check=True, capture_output=True, text=True).stdout.split()


needs_header = pytest.mark.skipif(
    not (shutil.which("gcc") and HEADER.exists()), reason="no gcc or no kernel headers"
)


@needs_header
def test_sizes_and_numbers_match_the_header(tmp_path: Path) -> None:
    body = "\n".join(f'printf("%lu\\n", (unsigned long)({name}));' for name in EXPECTED)
    assert dict(zip(EXPECTED, map(int, compiled(tmp_path, body)), strict=True)) == EXPECTED


@needs_header
def test_field_offsets_match_the_header(tmp_path: Path) -> None:
    body = "\n".join(
        f"{{ {kind} s; memset(&s, 0, sizeof s);\n"
        + "".join(f"s{name} = {value};\n" for name, (_, value) in fields.items())
        + 'for (unsigned i = 0; i < sizeof s; i++) printf("%02x", ((unsigned char *)&s)[i]);\n'
        + 'printf("\\n"); }'
        for kind, (_, fields) in FILLED.items()
    )
    for text, (layout, fields) in zip(compiled(tmp_path, body), FILLED.values(), strict=True):
        values = layout.unpack(bytes.fromhex(text))
        assert {name: values[k] for name, (k, _) in fields.items()} == {
            name: value for name, (_, value) in fields.items()
        }


def test_only_video_nodes_are_listed_sorted_by_number(tmp_path: Path) -> None:
    for name in ("video10", "video2", "video0", "video-codec", "video", "vbi0"):
        (tmp_path / name).touch()
    nodes = v4l2.LinuxVideoIO(tmp_path).nodes()
    assert [Path(node).name for node in nodes] == ["video0", "video2", "video10"]


def test_a_buffer_is_mapped_at_its_offset(tmp_path: Path) -> None:
    (tmp_path / "video0").write_bytes(b"a" * 8192 + b"buffer 2" + bytes(4088))
    io = v4l2.LinuxVideoIO(tmp_path)
    fd = io.open(io.nodes()[0])
    memory = io.map(fd, 4096, 8192)
    assert bytes(memory[:8]) == b"buffer 2"
    io.unmap(memory)
    io.close(fd)
    with pytest.raises(ValueError, match="closed"):
        memory[0]


def test_wait_ends_on_data_or_timeout() -> None:
    reader, writer = os.pipe()
    io = v4l2.LinuxVideoIO()
    assert not io.wait(reader, 0.01)
    os.write(writer, b"x")
    assert io.wait(reader, 10.0)
    os.close(reader)
    os.close(writer)


def test_a_node_that_is_not_a_camera_raises_oserror() -> None:
    reader, writer = os.pipe()
    with pytest.raises(OSError):
        v4l2.query_capability(v4l2.LinuxVideoIO(), reader)
    os.close(reader)
    os.close(writer)
