"""What a product lets one choose: words and limits that a command's help names. Light to import."""

from lightstage.formats import meshes, video

PLANE_FORMATS = ("png8", "png16", "exr", "npy")
FILMS = video.FORMATS
FILM_FORMATS = (*FILMS, "png")
MESH_FORMATS, NORMAL_MAPS = meshes.FORMATS, meshes.SPACES
MATERIAL_FORMATS = ("exr", "glb")

CONVENTIONS = {"opengl": "green = up (OpenGL)", "directx": "green = down (DirectX)"}
"""Where green points in a picture of normals."""
FRAME = "world: right-handed, x right, y up, z towards the camera"
"""Of normals and places."""

FILM_SLOWER, FILM_SLOWEST_FPS, FILM_FASTEST_FPS = 6, 5.0, 120.0
"""A film runs so much slower than the subject moved, and not below or above these rates, in frames a second."""
ALIGNMENT_POINTS = 3
"""Points that are marked in the alignment's pictures, at most: each has a colour of its own."""
SKIN_POINTS = 8
"""Spectra on a page, at most."""
ENVIRONMENT_LIGHTS = 256
"""That stand for an environment where nobody says how many: docs/methods/relighting.md."""
STRONGEST = 1e6
"""Of a light, and of an exposure."""

STIMULUS_KINDS = ("shape", "texture", "both")
MATCHES = ("none", "mean-contrast", "histogram", "spectrum")
NEAREST_EYES_PX = 15.0
"""Pixels between the eyes below which there is no face to see."""
