"""What we send, read by a Rust and a Node decoder, field by field; what they ask, answered by us.

`make interop`. Known messages go through our port and a pty; each decoder reads the bytes that came
out and prints every field. Each also makes a TIMESYNC request of its own.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from calm_edge.config import PoseOutputConfig
from calm_edge.pose_output.mavlink import (
    NAN,
    UNKNOWN_COVARIANCE,
    Encoder,
    Heartbeat,
    Message,
    Odometry,
    Severity,
    StatusText,
    SystemState,
    Timesync,
    status_texts,
)
from calm_edge.pose_output.publisher import PosePublisher
from device.serial_port import SerialPort

HERE = Path(__file__).parent
BUILD = Path("build/interop")
ASKED_NS = 1_234_567_890_123_456_789
LIMIT_S = 20.0


def known() -> list[Message]:
    """Every field with a value that no other has, and the special values of each."""
    full = Odometry(
        time_usec=2**53 + 12_345,
        position=(1234.5, -0.1, 1e-7),
        quaternion=(0.5, -0.5, 0.1, 0.7),
        velocity=(30.25, -1.5, 0.3),
        turn_rate=(0.01, -0.02, 1.5),
        pose_covariance=tuple(0.1 + k for k in range(21)),
        velocity_covariance=tuple(50.7 - k for k in range(21)),
        reset_counter=255,
        quality=100,
    )
    nothing = (NAN, NAN, NAN)
    lost = dataclasses.replace(
        full,
        position=nothing,
        quaternion=(NAN, *nothing),
        velocity=nothing,
        turn_rate=nothing,
        pose_covariance=UNKNOWN_COVARIANCE,
        velocity_covariance=UNKNOWN_COVARIANCE,
        reset_counter=256,
        quality=-1,
    )
    long = "calm-edge degraded: assistant camera silent; " + "disk full " * 10
    return [
        *(Heartbeat(state) for state in SystemState),
        full,
        lost,
        # zeros at the end of the payload do not travel
        dataclasses.replace(full, reset_counter=1, quality=0),
        *(dataclasses.replace(full, quality=q) for q in (1, 98)),
        *status_texts(Severity.WARNING, "calm-edge lost", 1),
        *status_texts(Severity.NOTICE, long, 513),
        *status_texts(Severity.INFO, "x" * 100, 65_535),
        Timesync(-(2**62) - 1, 2**62 + 1, (255, 190)),
        Timesync(1, 0),
    ]


def expected(message: Message) -> dict[str, Any]:
    """The fields of a message by the names of the standard."""
    match message:
        case Heartbeat():
            fields: dict[str, Any] = {
                "type": 18,
                "autopilot": 8,
                "base_mode": 0,
                "custom_mode": 0,
                "system_status": int(message.system_state),
                "mavlink_version": 3,
            }
        case StatusText():
            fields = {"severity": int(message.severity), "text": message.text.decode()}
            fields |= {"id": message.text_id, "chunk_seq": message.chunk}
        case Timesync():
            fields = {"tc1": message.tc1_ns, "ts1": message.ts1_ns}
            fields |= dict(zip(("target_system", "target_component"), message.target, strict=True))
        case Odometry():
            fields = dict(zip("xyz", message.position, strict=True))
            fields |= dict(zip(("vx", "vy", "vz"), message.velocity, strict=True))
            rates = ("rollspeed", "pitchspeed", "yawspeed")
            fields |= dict(zip(rates, message.turn_rate, strict=True))
            fields |= {
                "time_usec": message.time_usec,
                "frame_id": 20,
                "child_frame_id": 12,
                "q": list(message.quaternion),
                "pose_covariance": list(message.pose_covariance),
                "velocity_covariance": list(message.velocity_covariance),
                "reset_counter": message.reset_counter % 256,
                "estimator_type": 2,
                "quality": message.quality,
            }
        case _:
            raise TypeError(message)
    name = "STATUSTEXT" if isinstance(message, StatusText) else type(message).__name__.upper()
    return fields | {"name": name, "sender": [1, 197]}


def same(ours: Any, theirs: Any) -> bool:
    """Equal as the wire has it: floats of 32 bits; null is JSON's NaN, long integers are text."""
    if isinstance(ours, list):
        pairs = zip(ours, theirs, strict=False)
        return len(ours) == len(theirs) and all(same(a, b) for a, b in pairs)
    if isinstance(ours, float):
        if theirs is None or math.isnan(ours):
            return theirs is None and math.isnan(ours)
        return bool(np.float32(ours) == np.float32(theirs))
    if isinstance(ours, int):
        return ours == int(theirs)
    return bool(ours == theirs)


def differences(sent: list[dict[str, Any]], lines: list[dict[str, Any]]) -> list[str]:
    """One line for each field that arrived otherwise, was not sent, or did not arrive."""
    found = []
    if len(lines) != len(sent):
        found.append(f"{len(sent)} messages sent, {len(lines)} decoded")
    for k, (ours, theirs) in enumerate(zip(sent, lines, strict=False)):
        for key in sorted(ours.keys() | theirs.keys()):
            if key not in ours or key not in theirs or not same(ours[key], theirs[key]):
                a, b = ours.get(key, "nothing"), theirs.get(key, "nothing")
                found.append(f"message {k} {ours['name']}.{key}: sent {a}, decoded {b}")
    return found


class Line:
    """Our port, a pty, and every byte that came out of it."""

    def __init__(self) -> None:
        self._master, self._slave = os.openpty()
        os.set_blocking(self._master, False)
        self.port = SerialPort(os.ttyname(self._slave), 115_200, buffer_bytes=1 << 16)

    def hear(self, enough: int) -> bytes:
        """The bytes so far, once there are enough; raises TimeoutError."""
        data, limit = b"", time.monotonic() + LIMIT_S
        while len(data) < enough:
            if time.monotonic() > limit:
                raise TimeoutError(f"{len(data)} of {enough} bytes came through the pty")
            try:
                data += os.read(self._master, 65_536)
            except BlockingIOError:
                time.sleep(0.005)
        return data

    def ask(self, request: bytes) -> None:
        os.write(self._master, request)

    def close(self) -> None:
        self.port.stop()
        os.close(self._master)
        os.close(self._slave)


def stream(messages: list[Message]) -> bytes:
    """What comes out of the line for these messages."""
    encoder, line = Encoder(), Line()
    frames = [encoder.encode(message) for message in messages]
    line.port.start()
    try:
        for frame in frames:
            line.port.write(frame)
        return line.hear(sum(map(len, frames)))
    finally:
        line.close()


def answer(request: bytes) -> tuple[bytes, int]:
    """What our publisher answers to bytes that come in on the line, and the time it gave."""
    line, now_ns = Line(), 987_654_321_000_000
    publisher = PosePublisher(
        line.port, PoseOutputConfig(), spacing_known=True, now_ns=lambda: now_ns
    )
    line.port.start(publisher.receive)
    try:
        limit = time.monotonic() + LIMIT_S
        while not line.port.connected and time.monotonic() < limit:
            time.sleep(0.005)
        line.ask(request)
        return line.hear(30), now_ns
    finally:
        line.close()


def decoded(command: list[str], data: bytes) -> list[dict[str, Any]]:
    """What a decoder prints of these bytes."""
    path = BUILD / "stream.bin"
    path.write_bytes(data)
    done = subprocess.run([*command, "decode", str(path)], check=True, capture_output=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


def check(name: str, command: list[str]) -> bool:
    """Whether a decoder reads all we send and we answer what it asks; prints the outcome."""
    messages = known()
    sent = [expected(m) | {"sequence": k} for k, m in enumerate(messages)]
    found = differences(sent, decoded(command, stream(messages)))
    done = subprocess.run([*command, "request", str(ASKED_NS)], check=True, capture_output=True)
    reply, now_ns = answer(done.stdout)
    wanted = expected(Timesync(now_ns, ASKED_NS, (1, 1))) | {"sequence": 0}
    found += [f"answer to its request: {d}" for d in differences([wanted], decoded(command, reply))]
    fields = sum(len(message) for message in sent)
    for line in found:
        print(f"{name}: {line}")
    print(f"{name}: {len(messages)} messages, {fields} fields, {len(found)} differences")
    return not found


def rust() -> list[str] | None:
    """Builds the Rust decoder; None where there is no cargo."""
    if shutil.which("cargo") is None:
        return None
    target = (BUILD / "rust").resolve()
    manifest = str(HERE / "mavlink_rust" / "Cargo.toml")
    build = ["cargo", "build", "--quiet", "--locked", "--manifest-path", manifest]
    subprocess.run(build, check=True, env={**os.environ, "CARGO_TARGET_DIR": str(target)})
    return [str(target / "debug" / "mavlink_rust")]


def node() -> list[str] | None:
    """Installs the Node decoder's packages; None where there is no node."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        return None
    there = BUILD / "node"
    there.mkdir(parents=True, exist_ok=True)
    for source in sorted((HERE / "mavlink_node").iterdir()):
        shutil.copy(source, there)
    if not (there / "node_modules" / "node-mavlink").is_dir():
        quiet = ["--silent", "--no-audit", "--no-fund", "--ignore-scripts"]
        subprocess.run(["npm", "ci", *quiet], check=True, cwd=there)
    return ["node", str(there / "main.js")]


def main() -> int:
    """0 where every decoder that could be had agrees."""
    BUILD.mkdir(parents=True, exist_ok=True)
    good = True
    for name, make in (("rust", rust), ("node", node)):
        command = make()
        if command is None:
            print(f"{name}: skipped, {'cargo' if name == 'rust' else 'node and npm'} not found")
        else:
            good &= check(name, command)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
