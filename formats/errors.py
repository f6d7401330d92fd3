"""How a file, or the place for one, is refused."""


class FormatError(ValueError):
    """A file, or what stands in its place, is not what it has to be: one sentence that names it."""
