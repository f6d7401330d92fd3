"""Calibration targets: balls, boards, darks, flats and patterns, and what of the rig they tell."""
