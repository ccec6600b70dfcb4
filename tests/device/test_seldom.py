from device.seldom import PERIOD_S, Seldom


def test_one_line_a_minute_counts_the_others() -> None:
    now, said = [0.0], []
    seldom = Seldom(said.append, lambda: now[0])
    for k in range(5):
        now[0] = 0.1 * k
        seldom(f"frame {k}")
    now[0] = PERIOD_S + 0.1
    seldom("frame 5")
    seldom("frame 6")
    assert said == ["frame 0", "frame 5 (and 4 more since the last such line)"]
