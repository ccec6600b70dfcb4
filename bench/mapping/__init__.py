"""Map quality, paired: ours, each part of VI off, and the baselines, all on the same depth."""
