"""The learned model beside classical methods: correspondences, depth, places, whole drives."""
