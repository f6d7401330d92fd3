"""The rig measured from pictures: the stages of `calibration.yaml`, and the table that names them.

Each item is a short chain that ends in a stage with the item's name. Its `item` names the function that makes the
calibration item of its result, its `verdict` the one that says what a lab engineer should know. A new item is its
contents in `store/calibration.py`, and a stage here: a file, a line below, and its node in `calibration.yaml`.

    lights        outline -> highlights (a block a picture) -> lights
    camera        corners (a block a picture) -> camera
    homography    corners -> homography
    dark, flat    repeated frames; hot and dead pixels, gain, linearity
    bands         a white or grey target under every filter
    polarisers    outline -> highlights -> polarisers: a ball under every light at three polariser angles or more
    synchronisation   outline -> highlights -> synchronisation: the test patterns T0 to T3; a check, no item
"""

MEASURED = ("lights", "camera", "homography", "dark", "flat", "bands", "synchronisation", "polarisers")
"""What `lightstage calibrate` measures."""
STEPS = ("outline", "highlights", "corners")
"""What is found in the pictures on the way."""
