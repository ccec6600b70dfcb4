"""What a sub-map costs, stage by stage and over a long drive; measured, never asserted."""
