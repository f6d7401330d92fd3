"""Surface normals from pictures under known light."""
