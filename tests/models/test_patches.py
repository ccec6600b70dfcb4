"""The exportable rotary embedding, compared with its definition."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")


def test_positions_are_row_by_row():
    from exporting.patches import grid_positions

    grid = grid_positions(2, 2, 3, torch.device("cpu"))
    assert grid.tolist() == [[[0, 0], [0, 1], [0, 2], [1, 0], [1, 1], [1, 2]]] * 2


def test_rotary_embedding():
    """Channels (k, k + D / 4) of a half are rotated by position * base^(-4 k / D)."""
    from exporting.patches import rotated

    rng = np.random.default_rng(0)
    tokens = rng.standard_normal((2, 3, 5, 16))
    positions = rng.integers(0, 9, (2, 5, 2))
    out = rotated(torch.from_numpy(tokens), torch.from_numpy(positions), 100.0).numpy()
    for half in range(2):
        for k in range(4):
            a, b = 8 * half + k, 8 * half + k + 4
            angle = positions[:, None, :, half] * 100.0 ** (-k / 4)
            turned = (tokens[..., a] + 1j * tokens[..., b]) * np.exp(1j * angle)
            assert out[..., a] == pytest.approx(turned.real, abs=1e-5)
            assert out[..., b] == pytest.approx(turned.imag, abs=1e-5)


def test_patches_are_removed_after_the_context():
    from exporting.patches import applied

    class Base:
        def f(self):
            return 1

    class Derived(Base):
        pass

    with applied([(Base, "f", lambda self: 2), (Derived, "f", lambda self: 3)]):
        assert (Base().f(), Derived().f()) == (2, 3)
    assert (Base().f(), Derived().f()) == (1, 1)
    assert "f" not in vars(Derived)
