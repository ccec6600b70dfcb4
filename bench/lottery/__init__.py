"""Drives drawn by lot: places, rigs and focal lengths that nothing was tuned on."""
