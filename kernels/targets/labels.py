"""What measured things are called: labels that a declaration and its kernel share. Pure Python."""

OUTLINE_POINTS = 720
"""Of a ball's outline as it is stored: one every half degree."""
SPOTS = 2
"""Highlights of one picture that are told: a light makes one, a second says that something else shines."""
LIGHT_STATUS = ("seen", "dark", "saturated", "cut", "double", "missing")
"""What a picture shows of its light."""
CAMERA_PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
"""Of a camera matrix and its lens, in the order of OpenCV."""
FLAT_NUMBERS = (
    "electrons_per_count", "its_deviation", "read_noise_electrons", "linearity_percent", "offset", "frames",
    "dark_known",
)  # fmt: skip
"""What a flat tells of a sensor beside its picture."""
TEST_PATTERNS = ("T0", "T1", "T2", "T3", "O")
"""What a frame of a synchronisation test may show."""
