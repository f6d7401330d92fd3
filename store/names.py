"""What sessions and nodes may be called: their names are names of folders."""

import re

SESSION_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
NAME_RULE = "up to 100 letters, digits, dots, dashes and underscores, of which the first is a letter or digit"
