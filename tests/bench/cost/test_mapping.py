import pytest

from bench.cost import mapping
from bench.cost.mapping import STAGES, Cost, measure, table, timed_stages
from calm_edge.config import MappingConfig
from calm_edge.mapping import mapper
from tests.mapping import scene


def test_every_stage_is_counted_once_and_together_they_are_all(tmp_path):
    before = mapper.submap_points
    pieces = [
        (p.submap, p.depth, p.confidence, p.images) for p in scene.chain(scene.street(0), 2, 5)
    ]
    cost = measure(pieces, MappingConfig(max_range=24.0), scene.SPACING, tmp_path)
    assert {stage for stage, _, _ in STAGES} <= set(cost.seconds)
    assert all(seconds >= -1e-6 for seconds in cost.seconds.values())
    assert cost.submaps == 2 and cost.points > 4000 and 100 < cost.controls <= 300
    # nothing stays patched
    assert mapper.submap_points is before


def test_an_inner_stage_is_not_counted_twice(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(mapping.time, "process_time", lambda: now[0])

    class Work:
        def outer(self):
            now[0] += 2.0
            self.inner()
            self.inner()

        def inner(self):
            now[0] += 5.0

    monkeypatch.setattr(mapping, "STAGES", (("a", Work, "outer"), ("b", Work, "inner")))
    cost = Cost()
    with timed_stages(cost):
        Work().outer()
    assert cost.seconds == {"a": 2.0, "b": 10.0}


@pytest.mark.parametrize(("seconds", "kept"), [(0.5, True), (0.7, False)])
def test_the_requirement_is_a_submap_s_share(seconds, kept):
    cost = Cost(2, {"extract": 0.1, "fit": seconds - 0.1}, 500_000, 300)
    made = table(cost, "command")
    assert made.rows[-1] == ("all", pytest.approx(500 * seconds))
    assert made.checks[0].passed is kept
    assert "250,000 points and 150 control points each" in made.notes[0]
