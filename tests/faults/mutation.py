"""Seeded random damage to bytes and texts."""

from __future__ import annotations

import random
import struct

# extreme values for lengths, sizes and counts
_EXTREMES = (0, 1, 0x7F, 0xFF, 0x7FFF_FFFF, 0xFFFF_FFFF, 1 << 40, (1 << 63) - 1, (1 << 64) - 1)


def mutated(data: bytes, rng: random.Random, others: list[bytes]) -> bytes:
    """Return `data` with one to eight damages; pieces of `others` may be inserted."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        at = rng.randrange(len(out) + 1) if out else 0
        match rng.randrange(8):
            case 0 | 1:
                for _ in range(rng.choice((1, 1, 4, 64))):
                    if out:
                        out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
            case 2:
                del out[at:]
            case 3:
                del out[at : at + rng.randrange(1, 4096)]
            case 4:
                out[at:at] = rng.randbytes(rng.randrange(1, 512))
            case 5:
                width, kind = rng.choice(((4, "<I"), (8, "<Q"), (1, "<B"), (2, "<H")))
                extreme = rng.choice(_EXTREMES) & ((1 << 8 * width) - 1)
                out[at : at + width] = struct.pack(kind, extreme)
            case 6:
                other = rng.choice(others)
                start = rng.randrange(len(other))
                piece = other[start : start + rng.randrange(1, 4096)]
                out[at : at + rng.randrange(len(piece) + 1)] = piece
            case 7:
                out[at : at + rng.randrange(1, 256)] = b"\0" * rng.randrange(256)
    return bytes(out)


def mutated_text(text: str, rng: random.Random, words: list[str]) -> bytes:
    """Return a text with lines moved, repeated, cut or replaced, and sometimes bytes damaged."""
    lines = text.splitlines(keepends=True)
    for _ in range(rng.randrange(1, 6)):
        at = rng.randrange(len(lines)) if lines else 0
        match rng.randrange(5):
            case 0:
                lines.insert(at, rng.choice(words))
            case 1 if lines:
                lines.insert(rng.randrange(len(lines)), lines[at])
            case 2 if lines:
                lines.pop(at)
            case 3 if lines and "=" in lines[at]:
                lines[at] = f"{lines[at].split('=')[0]}= {rng.choice(words)}\n"
            case 4 if lines:
                lines[at] = lines[at][: rng.randrange(len(lines[at]) + 1)]
    data = "".join(lines).encode()
    return mutated(data, rng, [data or b"x"]) if rng.random() < 0.3 else data
