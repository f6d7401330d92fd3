"""Calibration targets: balls, boards, darks, flats and patterns, and what of the rig they tell.

A module with the name of a calibration stage holds what that stage names: its kernel, and the item and the verdict
that its result is. The others hold the methods, and know no stage.
"""
