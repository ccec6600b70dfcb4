"""Drives with randomly drawn track, start, rig and focal lengths, used for no tuning."""
