"""Feed damaged inputs to one reader of calm-edge under a memory limit; print the results.

`python -m tests.faults.malformed_child KIND COUNT SEED`. Ends with a traceback on any error other
than a one-line CalmEdgeError, and on an input that takes longer than LIMIT_S.
"""

from __future__ import annotations

import json
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from calm_edge.backbones.onnx.model_folder import read_manifest
from calm_edge.config import load
from calm_edge.pose_output.mavlink import Encoder, Heartbeat, Odometry, StatusText, SystemState
from calm_edge.pose_output.mavlink_parser import MavlinkParser
from calm_edge.recording import schema
from calm_edge.recording.reader import Recording
from calm_edge.recording.recovery import recover, validate
from calm_edge.types import CalmEdgeError
from tests.backbones.onnx.test_model_folder import FEEDFORWARD, folder_of
from tests.faults.mutation import mutated, mutated_text
from tests.recording import samples

LIMIT_S = 20
ADDRESS_SPACE = 3 << 30
RECOVER_EVERY = 10

Feed = Callable[[random.Random], bool]


def recordings(work: Path) -> Feed:
    """Validate, read and sometimes recover a recording; feeds return True if damage is reported."""
    whole = samples.small_recording(work / "whole") / "0000.mcap"
    bases = [whole.read_bytes()]
    bases += [
        _recompressed(whole, work, kind) for kind in (CompressionType.ZSTD, CompressionType.LZ4)
    ]
    path, copy = work / "damaged.mcap", work / "copy.mcap"
    fed = 0

    def feed(rng: random.Random) -> bool:
        nonlocal fed
        fed += 1
        path.write_bytes(mutated(rng.choice(bases), rng, bases))
        reported = bool(validate(path).losses)
        try:
            _read_all(Recording(path))
        except CalmEdgeError as error:
            assert "\n" not in str(error)
            reported = True
        if fed % RECOVER_EVERY == 0:
            recover(path, copy)
            copy.unlink(missing_ok=True)
        return reported

    return feed


def _recompressed(source: Path, work: Path, kind: CompressionType) -> bytes:
    """Rewrite the messages in compressed chunks, as other writers do."""
    path = work / f"{kind.name}.mcap"
    with path.open("wb") as out, source.open("rb") as file:
        writer = Writer(out, chunk_size=8192, compression=kind)
        writer.start()
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for kind_, channel, message in make_reader(file).iter_messages():
            assert kind_ is not None
            if kind_.id not in schemas:
                schemas[kind_.id] = writer.register_schema(kind_.name, kind_.encoding, kind_.data)
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[kind_.id]
                )
            writer.add_message(
                channels[channel.id],
                message.log_time,
                message.data,
                message.publish_time,
                message.sequence,
            )
        writer.finish()  # type: ignore[no-untyped-call]
    return path.read_bytes()


def _read_all(recording: Recording) -> None:
    """Read all types of data, each until its first error; raise the last error at the end."""
    readers: list[Callable[[], Iterator[object]]] = [
        recording.frames,
        recording.poses,
        recording.updates,
        recording.windows,
        lambda: recording.json_messages(schema.STATUS),
        lambda: iter([recording.config]),
        lambda: iter([recording.metadata]),
    ]
    refused: CalmEdgeError | None = None
    for reader in readers:
        try:
            for _ in islice(reader(), 1000):
                pass
        except CalmEdgeError as error:
            refused = error
    if refused is not None:
        raise refused


def configs(work: Path) -> Feed:
    """Load a configuration file; feeds return True if it raises."""
    text = (Path(__file__).parents[2] / "deploy" / "calm-edge.toml").read_text()
    text = (
        text.replace("#rate_hz", "rate_hz")
        .replace("#baud", "baud")
        .replace("#spacing_m", "spacing_m")
    )
    words = ["nan", "inf", "-1", "1e400", "[]", "{}", '""', '"x"', "true", "[capture]\n", "[[a]]\n",
             "0x" + "f" * 40, "9" * 400, "[1, [2, [3]]]", "2026-01-01", '"\\ud800"', "a.b.c = 1\n",
             "[" * 3000, "{a=" * 500]  # fmt: skip
    path = work / "damaged.toml"

    def feed(rng: random.Random) -> bool:
        path.write_bytes(mutated_text(text, rng, words))
        return _refused(lambda: load(path))

    return feed


def models(work: Path) -> Feed:
    """Read the manifest of a model folder; feeds return True if it raises."""
    folder = folder_of(work, FEEDFORWARD)
    text = (folder / "manifest.toml").read_text()
    words = ["-1", "nan", "[]", "{}", '"../../etc/passwd"', "true", "9" * 400, '["a"]', "1e400"]

    def feed(rng: random.Random) -> bool:
        (folder / "manifest.toml").write_bytes(mutated_text(text, rng, words))
        return _refused(lambda: read_manifest(folder))

    return feed


def _refused(attempt: Callable[[], object]) -> bool:
    try:
        attempt()
    except CalmEdgeError as error:
        # quoted values may hold anything, but the message must be one line
        assert "\n" not in str(error), repr(str(error))
        return True
    return False


def serial(work: Path) -> Feed:
    """Parse bytes of a serial line; feeds return True if a message is missing."""
    encoder = Encoder()
    kinds = (Heartbeat, StatusText, Odometry)
    valid = [encoder.encode(Heartbeat(SystemState.ACTIVE)) for _ in range(40)]
    stream = b"".join(valid)

    def feed(rng: random.Random) -> bool:
        parser = MavlinkParser(kinds)
        data = mutated(stream, rng, [stream])
        found, at = 0, 0
        while at < len(data):
            size = rng.randrange(1, 200)
            found += len(parser.feed(data[at : at + size]))
            at += size
        assert found <= 2 * len(valid) + len(data) // 21
        return found < len(valid)

    return feed


KINDS: dict[str, Callable[[Path], Feed]] = {
    "recordings": recordings,
    "configs": configs,
    "models": models,
    "serial": serial,
}


def main(kind: str, count: int, seed: int) -> None:
    """Print as JSON the number reported, the slowest [ms of CPU time] and the memory growth."""
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
    with tempfile.TemporaryDirectory() as work:
        feed = KINDS[kind](Path(work))
        before_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        reported, slowest_s = 0, 0.0
        for k in range(count):
            rng = random.Random(f"{seed}:{k}")
            started = time.process_time()
            signal.alarm(LIMIT_S)
            try:
                reported += feed(rng)
            except BaseException:
                print(f"{kind}: input {seed}:{k}", file=sys.stderr)
                with suppress(OSError):
                    for path in Path(work).glob("damaged.*"):
                        shutil.copy(path, Path(tempfile.gettempdir()) / f"calm-edge-{path.name}")
                raise
            finally:
                signal.alarm(0)
            slowest_s = max(slowest_s, time.process_time() - started)
    peak_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(
        json.dumps(
            {
                "reported": reported,
                "slowest_ms": 1e3 * slowest_s,
                "grown_mib": (peak_kib - before_kib) / 1024,
            }
        )
    )


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
