"""What the rig refuses."""


class RigError(ValueError):
    """A request that this rig cannot carry out: one sentence with what would be right."""
