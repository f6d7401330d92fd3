"""The error of kernels."""


class KernelError(ValueError):
    """What a kernel refuses: one sentence that says what is wrong and what would be right."""

    @property
    def sentence(self) -> str:
        """What is told to people."""
        return str(self)
