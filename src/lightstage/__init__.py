"""A light stage's pipeline: normals and reflectance from captures, computed once.

The folders at the top of the repository are packages below this one; here lie links to them, and what every
process does before anything computes.

    compiled.py     where compiled code is kept
    home.py         what is kept out of the user's home
"""

from lightstage.compiled import keep
from lightstage.home import spare_home

keep()
spare_home()
