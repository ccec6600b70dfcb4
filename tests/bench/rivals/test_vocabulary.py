"""The tree is valid for DBoW2's reader and distinguishes places."""

from pathlib import Path

import cv2
import numpy as np

from bench.rivals import vocabulary

RNG = np.random.default_rng(5)


def grown(descriptors: np.ndarray, source: np.ndarray) -> list[list[str]]:
    lines = vocabulary.grow(descriptors, source).splitlines()
    assert lines[0] == f"{vocabulary.BRANCHES} {vocabulary.LEVELS} 0 0"
    return [line.split() for line in lines[1:]]


def noisy_clusters(n: int, each: int) -> tuple[np.ndarray, np.ndarray]:
    centres = RNG.integers(0, 2, (n, 256))
    flips = RNG.random((n, each, 256)) < 0.03
    bits = (centres[:, None] ^ flips).reshape(-1, 256)
    return centres, np.packbits(bits.astype(np.uint8), axis=1)


def test_every_node_hangs_on_an_earlier_one_and_leaves_on_the_last_level() -> None:
    _, descriptors = noisy_clusters(40, 40)
    nodes = grown(descriptors, RNG.integers(0, 8, len(descriptors)))
    parents = [int(node[0]) for node in nodes]
    leaves = [node[1] == "1" for node in nodes]
    assert all(parent < k for k, parent in enumerate(parents, 1))
    assert not any(leaves[parent - 1] for parent in parents if parent)
    children = {parent: parents.count(parent) for parent in set(parents)}
    assert max(children.values()) <= vocabulary.BRANCHES
    # a node is a leaf exactly when nothing hangs on it
    assert all((k in children) != leaf for k, leaf in enumerate(leaves, 1))
    level = {0: 0}
    for k, parent in enumerate(parents, 1):
        level[k] = level[parent] + 1
    assert max(level.values()) <= vocabulary.LEVELS
    assert all(len(node) == 2 + 32 + 1 for node in nodes)
    assert all(0 <= int(byte) < 256 for node in nodes for byte in node[2:34])


def test_a_cluster_is_a_word_weighted_by_how_rarely_it_is_seen() -> None:
    centres, descriptors = noisy_clusters(8, 9)
    # the first cluster is on every picture, each other one on one picture alone
    source = np.repeat(np.arange(8), 9)
    source[:9] = np.arange(9) % 8
    nodes = grown(descriptors, source)
    words = np.array([[int(b) for b in node[2:34]] for node in nodes], np.uint8)
    distance = (np.unpackbits(words, axis=1)[:, None] != centres).sum(-1)
    assert (distance.min(0) <= 10).all()
    weight = np.array([float(node[34]) for node in nodes])[distance.argmin(0)]
    assert weight[0] < 0.3 and (weight[1:] > 1.9).all()


def test_a_drive_makes_its_own_once(tmp_path: Path) -> None:
    pictures = []
    for k in range(3):
        image = cv2.GaussianBlur(RNG.integers(0, 255, (120, 160), dtype=np.uint8), (0, 0), 1.5)
        pictures.append(tmp_path / f"{k}.png")
        cv2.imwrite(str(pictures[-1]), cv2.normalize(image, image, 0, 255, cv2.NORM_MINMAX))
    where = vocabulary.vocabulary_of(pictures, tmp_path / "v" / "d.txt")
    assert len(where.read_text().splitlines()) > 10
    where.write_text("kept")
    assert vocabulary.vocabulary_of(pictures, where).read_text() == "kept"


def test_pictures_without_a_corner_give_no_words(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((60, 60), np.uint8))
    descriptors, source = vocabulary.describe([tmp_path / "0.png", tmp_path / "gone.png"])
    assert descriptors.shape == (0, 32) and len(source) == 0
