"""The rig measured from pictures: stages of `calibration.yaml`, and the kernels that they call.

Each item is a short chain that ends in a stage with the item's name. Its `item` says what the calibration item is,
its `verdict` what a lab engineer should know.

    lights        outline -> highlights (a block a picture) -> lights
    camera        corners (a block a picture) -> camera
    homography    corners -> homography
    dark, flat    repeated frames; hot and dead pixels, gain, linearity
    bands         a white or grey target under every filter
    polarisers    a ball under every light at three polariser angles or more
    synchronisation   the test patterns T0 to T3 on the ball
"""
