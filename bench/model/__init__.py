"""The learned model against classical methods: correspondences, depth, places, whole drives."""
