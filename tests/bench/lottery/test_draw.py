"""Drives of the lottery: the same seed draws the same drive, whatever else is drawn."""

from bench.lottery import draw as lottery


def options(monkeypatch, seed, number):
    """Name, options of `record` and of the simulator, of a drive."""
    asked = []
    monkeypatch.setattr(lottery, "simulated", lambda name, *words: asked.extend((name, *words)))
    drawn = lottery.draw(seed, number)
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
