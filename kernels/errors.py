"""How a kernel refuses."""


class KernelError(ValueError):
    """What a kernel refuses: one sentence that says what is wrong and what would be right."""

    @property
    def sentence(self) -> str:
        """What is wrong and what would be right; who called the kernel adds where."""
        return str(self)
