"""The rig: its geometry, what drives its lights, and the virtual rig that stands in for all of it.

Imports nothing of ours outside itself.

    geodesic.py      where the lights are
    illuminations.py what illuminations are called, and which belong together
    cameras.py       which camera is the reference
    gradients.py     what each light is driven with, per illumination
    sequence.py      which illumination comes when, and what a tracking frame supports
    pacing.py        how fast a sequence plays, and whether it flashes
    planning.py      both together: a plan
    skin.py          what skin reflects, band by band
    head.py          the subject: a head as a distance field
    capture_folder.py, folder.py   capture folders that appear whole
    ball_targets.py, flat_targets.py, target_scenes.py   calibration targets as the virtual rig sees them
    color_checker.py the patches of a white-balance target
    motion.py        how the head turns, shifts and talks
    sensor.py        the cameras: response, dark, noise, bits
    virtual_rig.py   all of it together: a capture folder with ground truth
"""
