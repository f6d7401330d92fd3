"""What maps there are of skin's pigments. Pure Python: stages declare with it what they put out."""

MAPS = {
    "melanin": "optical depth at 576 nm",
    "haemoglobin": "see haemoglobin_unit",
    "baseline": "exp(-baseline) is the reflectance without pigments, relative to the model's for kubelka_munk",
    "residual": "RMS over bands of ln reflectance - fit",
    "melanin_standard_error": "by noise",
    "haemoglobin_standard_error": "by noise",
}
"""Those that three bands tell, each with what it holds."""
OXYGEN_MAPS = {
    "oxygenation": "share of haemoglobin that carries oxygen",
    "oxygenation_standard_error": "by noise and model_error",
}
OXYGEN_BANDS = 5
"""Bands that tell it: one more than there are unknowns, or every spectrum fits."""
