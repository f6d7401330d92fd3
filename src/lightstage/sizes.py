"""Sizes as a person reads them."""


def human_size(count: float) -> str:
    """Bytes as a person reads them: 1.5 GB, in powers of 1000."""
    for unit in ("B", "kB", "MB", "GB"):
        if abs(count) < 1000:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000
    return f"{count:.1f} TB"
