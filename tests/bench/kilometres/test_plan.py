from bench.kilometres import plan


def test_what_every_table_needs_comes_first():
    found = plan.batches(plan.TABLES, ["00", "04", "05"], [1, 2], ["04"])
    first = found[:3]
    assert [(b.name, b.seed, b.setting.name) for b in first] == [
        ("04", 1, "open"), ("05", 1, "open"), ("00", 1, "open"),
    ]  # fmt: skip
    assert [v.name for v in first[0].variants] == ["ours", "sim3", "sl4"]
    assert {(b.name, b.seed) for b in found} == {("00", 1), ("04", 1), ("04", 2), ("05", 1)}
    assert [b.name for b in found[-4:]] == ["00"] * 4


def test_loops_are_for_drives_that_come_back():
    found = plan.batches(["loops"], ["03", "05"], [1])
    assert [b.name for b in found if b.setting.loops] == ["05"]


def test_only_what_a_table_needs_is_run():
    (batch,) = plan.batches(["focal"], ["03"], [1])
    assert [v.name for v in batch.variants] == ["ours"]
