"""What `map` does before the Mapper: every window's sub-map, and its depth."""
