"""Drives of the lottery: the same seed draws the same drive, whatever else is drawn."""

import numpy as np

from bench.lottery import draw as lottery


def options(monkeypatch, seed, number, kind="plain"):
    """Name, options of `record` and of the simulator, of a drive."""
    asked = []
    monkeypatch.setattr(lottery, "simulated", lambda name, *words: asked.extend((name, *words)))
    drawn = lottery.draw(seed, number, kind)
    return drawn.name, drawn.options, tuple(asked)


def test_a_drive_depends_on_seed_and_number_alone(monkeypatch):
    first = [options(monkeypatch, 3, k) for k in range(4)]
    assert [options(monkeypatch, 3, k) for k in (2, 0)] == [first[2], first[0]]
    assert len({words[1:] for *_, words in first}) == 4
    assert options(monkeypatch, 4, 0)[2][1:] != first[0][2][1:]


def test_drives_stay_on_their_track_and_within_the_rigs_drawn(monkeypatch):
    for k in range(50):
        _, (option, spacing), words = options(monkeypatch, 1, k)
        track = words[words.index("--track") + 1]
        start_m = float(words[words.index("--skip-s") + 1])
        assert 0 <= start_m < lottery.TRACKS[track] - 150
        assert option == "--spacing-m"
        assert lottery.SPACING_M[0] <= float(spacing) <= lottery.SPACING_M[1]
        assert words[words.index("--baseline") + 1] == spacing


def values(words, key):
    """Numbers after an option."""
    rest = words[words.index(key) + 1 :]
    end = next((k for k, word in enumerate(rest) if word.startswith("--")), len(rest))
    return [float(word) for word in rest[:end]]


def test_a_real_drive_is_where_the_plain_one_is_with_lenses_that_can_be_inverted(monkeypatch):
    fisheyes = 0
    for k in range(60):
        _, spacing, plain = options(monkeypatch, 1, k)
        name, own, words = options(monkeypatch, 1, k, "real")
        assert name.startswith("lottery_real_") and own == spacing
        for key in ("--track", "--skip-s", "--seed"):
            assert words[words.index(key) + 1] == plain[plain.index(key) + 1]
        fisheyes += "--fisheye" in words
        if "--fisheye" in words:
            continue
        for eye, hfov in enumerate(values(words, "--hfov")):
            k1, k2, *_ = values(words, f"--lens{eye}")
            corner = np.tan(np.radians(hfov) / 2) * np.hypot(640, 360) / 640
            r = np.linspace(0, 4, 2000)
            seen = r + k1 * r**3 + k2 * r**5
            first = np.argmax(seen > corner)
            assert first and (np.diff(seen[: first + 1]) > 0).all()
    assert 8 < fisheyes < 35
