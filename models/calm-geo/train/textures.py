"""Collect freely licensed photographs and textures of Debian packages as grey squares.

    python textures.py --out build/textures.npz

Packages (licences in each one's /usr/share/doc/*/copyright): supertuxkart-data (CC-BY-SA, CC-BY,
CC0, GPL by file), ufoai-textures (GPL-2+, CC-BY-SA-3.0, CC-BY-3.0), plasma-workspace-wallpapers
(GPL-2+), mate-backgrounds (GPL-2+, CC-BY-SA-4.0), lomiri-wallpapers-16.04 and -20.04 (CC-BY-SA,
CC-BY-4.0), stellarium-data (GPL-2+). They are used for training only; no image is shipped.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

PACKAGES = (
    "supertuxkart-data",
    "ufoai-textures",
    "plasma-workspace-wallpapers",
    "mate-backgrounds",
    "lomiri-wallpapers-16.04",
    "lomiri-wallpapers-20.04",
    "stellarium-data",
)
PICTURES = (".jpg", ".jpeg", ".png", ".tga", ".webp")
# Normal, gloss and light maps, fonts and icons are no photographs or textures.
SKIPPED = ("normal", "gloss", "specul", "_n.", "_nm.", "_s.", "_lm.", "_gm.", "font", "icon", "gui")
SIZE = 256
MIN_SIDE = 256
MIN_SPREAD = 14.0
MIN_DETAIL = 3.0
CROPS_OF_A_LARGE = 6


def unpacked(package: str, folder: Path) -> Path:
    """Download a Debian package with apt-get and unpack it to folder/package; returns that."""
    out = folder / package
    if not out.exists():
        subprocess.run(["apt-get", "download", "-q", package], cwd=folder, check=True)
        deb = next(folder.glob(f"{package}_*.deb"))
        subprocess.run(["dpkg", "-x", deb, out], check=True)
        deb.unlink()
    return out


def pictures(root: Path) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Yield (name, grey image (H, W)) of all images below root and in its .pk3 archives."""
    for path in sorted(root.rglob("*")):
        if path.suffix.lower() == ".pk3":
            with zipfile.ZipFile(path) as archive:
                for name in sorted(archive.namelist()):
                    yield from _decoded(name, archive.read(name))
        elif path.is_file() and not path.is_symlink():
            yield from _decoded(str(path.relative_to(root)), path.read_bytes())


def _decoded(name: str, data: bytes) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    low = name.lower()
    if not low.endswith(PICTURES) or any(word in low for word in SKIPPED):
        return
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    if image is not None and min(image.shape) >= MIN_SIDE:
        yield name, np.asarray(image, np.uint8)


def squares(image: NDArray[np.uint8], random: np.random.Generator) -> Iterator[NDArray[np.uint8]]:
    """Yield crops (SIZE, SIZE) with enough contrast and detail; several of a large image."""
    height, width = image.shape
    for _ in range(CROPS_OF_A_LARGE if min(height, width) >= 4 * SIZE else 1):
        side = int(min(height, width) * random.uniform(0.35, 1)) if min(height, width) > 512 else 0
        side = max(side, min(height, width, SIZE))
        y, x = random.integers(height - side + 1), random.integers(width - side + 1)
        crop = cv2.resize(
            image[y : y + side, x : x + side], (SIZE, SIZE), interpolation=cv2.INTER_AREA
        )
        detail = float(np.abs(cv2.Laplacian(crop, cv2.CV_32F)).mean())
        if crop.std() > MIN_SPREAD and detail > MIN_DETAIL:
            yield np.asarray(crop, np.uint8)


def bank(folder: Path, count: int, seed: int) -> NDArray[np.uint8]:
    """Textures (N, SIZE, SIZE), uint8, N <= count, drawn at random from all packages."""
    random = np.random.default_rng(seed)
    of_package = [
        [square for _, image in pictures(unpacked(p, folder)) for square in squares(image, random)]
        for p in PACKAGES
    ]
    for package, found in zip(PACKAGES, of_package, strict=True):
        print(f"{package}: {len(found)} squares")
    everything = [s for found in of_package for s in found]
    random.shuffle(everything)
    return np.stack(everything[:count])


def save(path: Path, textures: NDArray[np.uint8]) -> None:
    """Write textures as JPEG data in one .npz file."""
    coded = [cv2.imencode(".jpg", t, [cv2.IMWRITE_JPEG_QUALITY, 88])[1].ravel() for t in textures]
    ends = np.cumsum([len(c) for c in coded])
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, data=np.concatenate(coded), ends=ends)


def load(path: Path) -> NDArray[np.uint8]:
    """Read textures (N, SIZE, SIZE), uint8, written by `save`."""
    with np.load(path) as file:
        parts = np.split(file["data"], file["ends"][:-1])
    return np.stack([np.asarray(cv2.imdecode(p, cv2.IMREAD_GRAYSCALE), np.uint8) for p in parts])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("build/textures.npz"))
    parser.add_argument("--packages", type=Path, help="a folder to keep unpacked packages in")
    parser.add_argument("--count", type=int, default=1500)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.packages or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        save(arguments.out, bank(folder, arguments.count, seed=0))
    print(f"{arguments.out}: {arguments.out.stat().st_size / 2**20:.1f} MiB")


if __name__ == "__main__":
    main()
