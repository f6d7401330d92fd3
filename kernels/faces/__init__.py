"""Several faces: brought to one place, mixed, and made equal in what an experiment must not vary."""
